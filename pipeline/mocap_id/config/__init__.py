"""Trial and study configurations: YAML in, frozen models out; every mistake with file, line, key and nearest name."""

from mocap_id.config.study import Person, Study, StudyTrial, load_study, study_schema
from mocap_id.config.trial import Trial, load, schema, trial_model

__all__ = ["Person", "Study", "StudyTrial", "Trial", "load", "load_study", "schema", "study_schema", "trial_model"]
