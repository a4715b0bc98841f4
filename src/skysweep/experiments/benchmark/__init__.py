"""A versioned suite of missions on which search strategies are compared."""

BENCHMARK_PAGE, BREAK_EVEN_PAGE = "benchmark.html", "break-even.html"  # what their folders hold
