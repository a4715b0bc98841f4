"""Its folder is where the tests below it find ``contexts``."""
