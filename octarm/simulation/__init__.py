"""Stepping arms: physics, environment, and the only simulation loop."""
