"""Trial and study configurations: YAML in, frozen models out; every mistake with file, line, key and nearest name.

Studies are in :mod:`mocap_id.config.study`: who runs a trial does not load them.
"""

from mocap_id.config.trial import Trial, load, schema, trial_model

__all__ = ["Trial", "load", "schema", "trial_model"]
