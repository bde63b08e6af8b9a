"""Configuration files: YAML is read into immutable models, and every mistake is reported with file, line and key.

Studies are in :mod:`mocap_id.config.study`, so that running a trial does not import them.
"""

from mocap_id.config.trial import Trial, build_schema, build_trial_model, load

__all__ = ["Trial", "build_schema", "build_trial_model", "load"]
