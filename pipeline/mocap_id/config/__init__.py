"""Configuration files: YAML to frozen models, with every mistake reported by file, line and key.

Studies are in :mod:`mocap_id.config.study`, so that running a trial does not import them.
"""

from mocap_id.config.trial import Trial, load, schema, trial_model

__all__ = ["Trial", "load", "schema", "trial_model"]
