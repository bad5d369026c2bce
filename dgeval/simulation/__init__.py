"""A simulated grasp cell that writes recordings with known truth."""
