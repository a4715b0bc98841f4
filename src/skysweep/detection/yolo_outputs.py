"""Recognises what a model's outputs mean from its answer to a blank picture.

Users need not say which model a file holds. Each recogniser looks at the shapes (and at a few values if the
shapes are ambiguous) and returns an ``OutputLayout`` or None; the first layout wins.
"""

from __future__ import annotations

from skysweep.detection import cell_layouts, grid_layouts, listed_layouts
from skysweep.detection.layouts import OutputLayout, Probe

_RECOGNISERS = (
    listed_layouts.tensorflow_lists,
    listed_layouts.labelled_boxes,
    listed_layouts.scored_boxes,
    listed_layouts.detr,
    cell_layouts.boxes_and_scores,
    cell_layouts.anchored_rows,
    cell_layouts.nanodet_rows,
    cell_layouts.cell_columns,
    cell_layouts.cell_rows,
    listed_layouts.final_rows,
    grid_layouts.raw_grids,
)


def recognise(probe: Probe) -> OutputLayout | None:
    """The layout of a model's outputs, or None if it is unknown. Raises Unclear if it stays open."""
    layouts = (recogniser(probe) for recogniser in _RECOGNISERS)
    return next((layout for layout in layouts if layout is not None), None)
