"""The strategy of the example, under the name by which the pages call a reader's own."""

from examples.strategy import Halfway as MyStrategy

__all__ = ["MyStrategy"]
