"""upio."""
