"""The paper's results on this arm, as a client of the public interface."""
