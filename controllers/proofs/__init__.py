"""The Lyapunov functions of the controllers, and the checks that they fall."""
