"""What acts on the arm that the controller does not know."""
