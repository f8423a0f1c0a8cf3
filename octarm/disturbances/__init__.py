"""What acts on the arm that its controller does not know."""
