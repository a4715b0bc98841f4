"""The counts of evaluations as JSON and as tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from skysweep.detection.training.evaluate import (
    ALTITUDE_BINS_M,
    CONFIRMING_CONFIDENCE,
    LIGHT_BINS,
    PIXEL_BINS,
    DecoyScore,
    Evaluation,
    Picture,
    Score,
    bin_of,
)
from skysweep.experiments.pictures.curves import precision_recall
from skysweep.results.reporting.html import Grid

Evaluations = Mapping[str, Evaluation]  # by the name of the detector, all of the same pictures


def classes_json(evaluation: Evaluation) -> dict[str, Any]:
    """Recall, precision and false reports of each class, and its recall by pixels on target."""
    return {name: _class_json(evaluation, name) for name in evaluation.classes}


def _class_json(evaluation: Evaluation, name: str) -> dict[str, Any]:
    score, curve = evaluation.total(name), precision_recall(evaluation, name)
    sizes = [(lower, evaluation.by_pixels.get((name, float(lower)))) for lower in PIXEL_BINS[:-1]]
    return {
        "n": score.n_targets,
        "recall": _ratio(score.n_found, score.n_targets),
        "precision": _ratio(score.n_found, score.n_found + score.n_false),
        "false_per_picture": score.n_false / evaluation.n_images,
        "false_per_hectare": evaluation.false_per_hectare(name),
        "average_precision": curve.average_precision if curve else None,
        "by_pixels": [
            {"lo": float(lo), "hi": _end(lo, PIXEL_BINS), "n": s.n_targets, "recall": s.n_found / s.n_targets}
            for lo, s in sizes
            if s is not None and s.n_targets
        ],
    }


def scores_json(evaluation: Evaluation) -> dict[str, Any]:
    """The counts of an evaluation. Bins are ``from`` to ``to``, null without an end."""
    return {
        "n_images": evaluation.n_images,
        "hectares": evaluation.hectares,
        "confidence_min": evaluation.confidence_min,
        "classes": classes_json(evaluation),
        "by_pixels": _counts_json(evaluation.by_pixels, PIXEL_BINS),
        "by_altitude": _counts_json(evaluation.by_altitude, ALTITUDE_BINS_M),
        "by_light": _counts_json(evaluation.by_light, LIGHT_BINS),
        "confusions": _counts_json(evaluation.decoys, PIXEL_BINS),
    }


def _counts_json(
    counts: Mapping[tuple[str, float], Score | DecoyScore], edges: Sequence[float]
) -> list[dict[str, Any]]:
    return [
        {"class": name, "from": lower, "to": _end(lower, edges), **asdict(counted)}
        for (name, lower), counted in sorted(counts.items(), key=lambda item: item[0])
    ]


def _end(lower: float, edges: Sequence[float]) -> float | None:
    upper = float(edges[list(edges).index(lower) + 1])
    return None if np.isinf(upper) else upper


def grids(evaluations: Evaluations) -> list[Grid]:
    """All tables, the detectors side by side: by class, size, altitude, light, and what is taken for what."""
    first = next(iter(evaluations.values()))
    made = [
        _by_class(evaluations),
        _divided(evaluations, "By pixels on target", "by_pixels", PIXEL_BINS, "px"),
    ]
    if first.by_altitude:
        made.append(_divided(evaluations, "By altitude", "by_altitude", ALTITUDE_BINS_M, "m AGL"))
    made.append(_divided(evaluations, "By light", "by_light", LIGHT_BINS, "brightness"))
    if first.decoys:
        made.append(_confusions(evaluations))
    return made


def _by_class(evaluations: Evaluations) -> Grid:
    first = next(iter(evaluations.values()))
    titles = (f"recall at {first.confidence_min:g}", f"at {CONFIRMING_CONFIDENCE:g}", "precision")
    header = [
        "class",
        "labels",
        *_side_by_side(evaluations, (*titles, "false / picture", "false / ha", "AP")),
    ]
    rows = []
    for name in _classes(evaluations):
        cells = []
        for e in evaluations.values():
            score, curve, per_ha = e.total(name), precision_recall(e, name), e.false_per_hectare(name)
            cells += [*_cells(score, e.n_images), "-" if per_ha is None else f"{per_ha:.2f}"]
            cells.append("-" if curve is None else f"{curve.average_precision:.2f}")
        rows.append([name, str(first.total(name).n_targets), *cells])
    ground = "" if first.hectares is None else f", {first.hectares:.1f} ha of ground"
    return Grid(header, rows, f"By class ({first.n_images} pictures{ground})")


def _divided(evaluations: Evaluations, title: str, attribute: str, edges: Sequence[float], unit: str) -> Grid:
    first = next(iter(evaluations.values()))
    pictures = _pictures_by(attribute, first, edges)
    titles = (f"recall at {first.confidence_min:g}", f"at {CONFIRMING_CONFIDENCE:g}", "precision")
    header = ["class", unit, "labels", *_side_by_side(evaluations, (*titles, "false / picture"))]
    rows = []
    for name in _classes(evaluations):
        for lower in map(float, edges[:-1]):
            scores = [getattr(e, attribute).get((name, lower), Score()) for e in evaluations.values()]
            if any(s.n_targets or s.n_false for s in scores):
                cells = [cell for s in scores for cell in _cells(s, pictures.get(lower, first.n_images))]
                rows.append([name, _bin_label(lower, edges), str(scores[0].n_targets), *cells])
    return Grid(header, rows, title)


def _pictures_by(attribute: str, evaluation: Evaluation, edges: Sequence[float]) -> dict[float, int]:
    """The pictures in each bin; sizes are in all of them."""
    value_of = {"by_altitude": _altitude, "by_light": _brightness}.get(attribute)
    if value_of is None:
        return {}
    bins = [bin_of(v, edges) for picture in evaluation.pictures if (v := value_of(picture)) is not None]
    return {lower: bins.count(lower) for lower in set(bins)}


def _altitude(picture: Picture) -> float | None:
    return picture.altitude_agl_m


def _brightness(picture: Picture) -> float | None:
    return picture.brightness


def _confusions(evaluations: Evaluations) -> Grid:
    first = next(iter(evaluations.values()))
    titles = (f"at {first.confidence_min:g}", f"at {CONFIRMING_CONFIDENCE:g}", "taken for")
    header = ["label or look-alike", "px", "seen", *_side_by_side(evaluations, titles)]
    rows = []
    for (kind, lower), seen in sorted(first.decoys.items()):
        scores = [e.decoys[kind, lower] for e in evaluations.values()]
        cells = [
            cell for d in scores for cell in (_share(d.n_taken, d.n), _share(d.n_confirmed, d.n), _names(d))
        ]
        rows.append([kind, _bin_label(lower, PIXEL_BINS), str(seen.n), *cells])
    return Grid(header, rows, "What is taken for something else")


def _names(score: DecoyScore) -> str:
    often = sorted(score.taken_for.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{name} {n}" for name, n in often) or "-"


def _side_by_side(evaluations: Evaluations, titles: Sequence[str]) -> Iterator[str]:
    """The titles for each detector, below its name where there are several."""
    for label in evaluations:
        for title in titles:
            yield f"{label}\n{title}" if len(evaluations) > 1 else title


def _classes(evaluations: Evaluations) -> list[str]:
    return list(dict.fromkeys(c for e in evaluations.values() for c in e.classes))


def _cells(score: Score, n_pictures: int) -> list[str]:
    return [
        _share(score.n_found, score.n_targets),
        _share(score.n_confirming, score.n_targets),
        _share(score.n_found, score.n_found + score.n_false),
        f"{score.n_false / n_pictures:.3f}",
    ]


def _bin_label(lower: float, edges: Sequence[float]) -> str:
    upper = _end(lower, edges)
    return f">= {lower:g}" if upper is None else f"{lower:g} to {upper:g}"


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.2f}" if whole else "-"
