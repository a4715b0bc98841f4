"""A versioned suite of missions on which search strategies are compared."""
