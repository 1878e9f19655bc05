"""Relevance of causes: by how much each changes the open-loop prediction, or reduces its error on held-out
flights.

Without disturbances, a flight shows effects far below an encoder count, as small as numerical errors of the
method. A cause is named only if it is significant and matters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.explain.evaluate.prediction import Prediction, normalised_samples, predict
from heli_lab.explain.search.hypothesis import Hypothesis
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.stepwise import Search
from heli_lab.explain.thresholds import DISTURBED_STD, MATTERS_NATS_PER_ROW


def prediction_changes(
    comparison: ModelComparison, search: Search, extended: Hypothesis, before: Prediction, after: Prediction
) -> Mapping[str, float]:
    """Compute by how much each cause changes the 2 s open-loop prediction.

    The model with all causes is compared with the refitted model without the cause, on the axis where they
    differ most. The change is the root mean square difference of their predictions on the fitted flights. If
    the model without the cause adds a larger error on the held-out flights, the change is that error.
    """
    if not extended.candidates or after.train.total > DISTURBED_STD:
        return {}
    samples_with_all = normalised_samples(after.fit)
    changes = {}
    evidence = {cause.effect: cause.train for cause in search.causes}
    for candidate in extended.candidates:
        if len(extended.candidates) > 1 and (evidence[candidate.id] > MATTERS_NATS_PER_ROW * comparison.rows):
            continue
        other_causes = [other for other in extended.candidates if other is not candidate]
        # The elimination has estimated this model: it is in the cache.
        reduced = (
            predict(
                comparison.refit(other_causes, None, extended).estimate, comparison.train, comparison.held_out
            )
            if other_causes
            else before
        )
        difference = samples_with_all - normalised_samples(reduced.fit)
        added_error = np.maximum(reduced.held_out.axes**2 - after.held_out.axes**2, 0.0)
        changes[candidate.id] = max(map(_largest_counts, (np.mean(difference**2, axis=0), added_error)))
    return changes


def spline_change(
    comparison: ModelComparison, search: Search, extended: Hypothesis, after: Prediction
) -> float:
    """Compute by how much the spline terms of a search change the 2 s open-loop prediction, encoder counts.

    The final model is compared with the `extended` model, which lacks only them, as `prediction_changes`
    does; `after` is the prediction of the latter. Infinite without spline terms.
    """
    if extended is search.final or after.train.total > DISTURBED_STD:
        return math.inf
    final = predict(search.final.estimate, comparison.train, comparison.held_out)
    difference = normalised_samples(final.fit) - normalised_samples(after.fit)
    reduced_error = np.maximum(after.held_out.axes**2 - final.held_out.axes**2, 0.0)
    return max(map(_largest_counts, (np.mean(difference**2, axis=0), reduced_error)))


def _largest_counts(mean_squares: Floats) -> float:
    """Return the largest root mean square of the axes, in encoder counts.

    `mean_squares` (3,) are in units of the quantisation's variance, which is a twelfth of a squared count.
    """
    return float(np.sqrt(mean_squares / 12.0).max())
