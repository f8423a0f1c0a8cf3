"""The arm: its numbers, its equations of motion, and its MuJoCo model."""
