"""What ``import mocap_id`` offers: runs, studies and simulations, with results as attributes."""
