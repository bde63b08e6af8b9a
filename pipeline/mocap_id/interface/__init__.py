"""The Python interface of ``import mocap_id``: runs, studies and simulations, with results as attributes."""
