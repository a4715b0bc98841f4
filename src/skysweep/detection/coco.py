"""Class names for models without names in their metadata."""

from __future__ import annotations

COCO_80: tuple[str, ...] = tuple(
    """person,bicycle,car,motorcycle,airplane,bus,train,truck,boat,traffic light,fire hydrant,stop sign,
    parking meter,bench,bird,cat,dog,horse,sheep,cow,elephant,bear,zebra,giraffe,backpack,umbrella,handbag,
    tie,suitcase,frisbee,skis,snowboard,sports ball,kite,baseball bat,baseball glove,skateboard,surfboard,
    tennis racket,bottle,wine glass,cup,fork,knife,spoon,bowl,banana,apple,sandwich,orange,broccoli,carrot,
    hot dog,pizza,donut,cake,chair,couch,potted plant,bed,dining table,toilet,tv,laptop,mouse,remote,keyboard,
    cell phone,microwave,oven,toaster,sink,refrigerator,book,clock,vase,scissors,teddy bear,hair drier,
    toothbrush""".replace("\n    ", "").split(",")
)
"""The 80 classes of COCO 2017 in the order that YOLO models are trained with."""

_NOT_LABELLED = (0, 12, 26, 29, 30, 45, 66, 68, 69, 71, 83)


def _with_gaps() -> tuple[str, ...]:
    names = iter(COCO_80)
    return tuple("N/A" if i in _NOT_LABELLED else next(names) for i in range(91))


COCO_91: tuple[str, ...] = _with_gaps()
"""COCO's own category ids 0..90, gaps included, as DETR models use them."""


def default_names(n_classes: int) -> tuple[str, ...] | None:
    """The names that a model with this many classes has by convention, or None."""
    return {80: COCO_80, 91: COCO_91}.get(n_classes)
