"""Trial configurations: YAML in, frozen models out; every mistake with file, line, key and the nearest good name."""

from mocap_id.config.trial import Trial, load, schema, trial_model

__all__ = ["Trial", "load", "schema", "trial_model"]
