"""A weighted set of hypotheses: the one value that every tracker proposes, weighs, selects and reads.

Weights live in the log domain and are only defined up to a common factor per population, so adding evidence
never under- or overflows. Two columns are inherited by selection: ``origin``, where a hypothesis comes from, and
``role``, what it is. A survival rate is therefore a histogram of a column, and no method needs hidden state or a
particular row.
Source: Alcoverro 2014, section 2.2.1 (weighted particle set, eq. 2.5); batch axes for the swarm of
Asteriadis et al. 2013.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
_IntArray = NDArray[np.int32]


BEFORE = "before"
"""Column: the state (D,) that each hypothesis had a step ago, its own history."""
FOUND_BY = "by "
"""Roles that begin so say which search found a hypothesis: "by limb search"."""


def _none() -> _IntArray:
    return np.zeros((), np.int32)


@dataclass(frozen=True)
class Hypotheses:
    """N states per population with their log-weights. Never mutated: every operation returns a new set.

    values (*B, N, D) float64, in the units of the caller.
    log_weights (*B, N) float64, up to a constant per population, NaN and +inf count as no evidence for that hypothesis
        (weight 0).
    origin (*B, N) int32: the number of the sensor, kernel or parent that it comes from.
    role (*B, N) int32: any number of roles, bit k stands for role_names[k]; read it with ``has`` and write it with
        ``marked``. One number for a column stands for all hypotheses.
    covariance (*B, N, D, D) float64 of each single hypothesis, or None.
    columns: whatever else belongs to each single hypothesis (a velocity, a cost), arrays (*B, N, ...) by name.

    Raises ValueError when the shapes do not agree or a population is empty.
    """

    values: FloatArray
    log_weights: FloatArray
    origin: _IntArray = field(default_factory=_none)
    role: _IntArray = field(default_factory=_none)
    role_names: tuple[str, ...] = ()
    covariance: FloatArray | None = None
    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        values = np.asarray(self.values, dtype=np.float64)
        log_weights = np.asarray(self.log_weights, dtype=np.float64)
        if values.ndim < 2 or values.shape[-2] == 0:
            raise ValueError(f"hypotheses need values of shape (..., N, D) with N >= 1, got {values.shape}")
        if log_weights.shape != values.shape[:-1]:
            raise ValueError(
                f"log_weights {log_weights.shape} must be {values.shape[:-1]}, the shape {values.shape} of the values "
                "without the last axis"
            )
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "log_weights", log_weights)
        for name in ("origin", "role"):
            column = np.asarray(getattr(self, name), dtype=np.int32)
            if column.ndim == 0:
                column = np.broadcast_to(column, log_weights.shape)
            if column.shape != log_weights.shape:
                raise ValueError(f"{name} {column.shape} must be {log_weights.shape}, one number per hypothesis")
            object.__setattr__(self, name, column)
        if self.covariance is not None:
            covariance = np.asarray(self.covariance, dtype=np.float64)
            if covariance.shape != (*values.shape, values.shape[-1]):
                raise ValueError(f"covariance must be {(*values.shape, values.shape[-1])}, got {covariance.shape}")
            object.__setattr__(self, "covariance", covariance)
        for name, column in self.columns.items():
            if column.shape[: log_weights.ndim] != log_weights.shape:
                raise ValueError(f"the column '{name}' {column.shape} needs one row per hypothesis {log_weights.shape}")

    @staticmethod
    def uniform(values: ArrayLike, origin: ArrayLike = 0) -> Hypotheses:
        """Equal weights 1/N for values (*B, N, D), which come from origin (*B, N)."""
        states = np.asarray(values, dtype=np.float64)
        return Hypotheses(states, _equal_log_weights(states), np.asarray(origin, np.int32))

    def equal(self, values: FloatArray | None = None) -> Hypotheses:
        """Return the same hypotheses, or other values (*B, N, D) for them, with equal weights 1/N."""
        return (self if values is None else self.at(values))._with(log_weights=_equal_log_weights(self.values))

    def at(self, values: FloatArray) -> Hypotheses:
        """Return the same hypotheses at other values (*B, N, D)."""
        assert values.shape == self.values.shape and values.dtype == np.float64
        return self._with(values=values)

    def _with(self, **changed: Any) -> Hypotheses:
        """`dataclasses.replace` where shapes and types are known to be right: it is called often in every frame."""
        out = object.__new__(Hypotheses)
        for name in _FIELDS:
            object.__setattr__(out, name, changed.get(name, getattr(self, name)))
        return out

    def has(self, role: str) -> NDArray[np.bool_]:
        """Return (*B, N) True for the hypotheses in this role; False everywhere for an unknown role."""
        if role not in self.role_names:
            return np.zeros(self.role.shape, np.bool_)
        return (self.role >> self.role_names.index(role) & 1).astype(np.bool_)

    def marked(self, role: str, members: ArrayLike) -> Hypotheses:
        """Return the same set with this role given to the members (*B, N) bool, or their indices, and taken from all
        others.

        A set knows at most 31 roles; ValueError at the next one.
        """
        names = self.role_names if role in self.role_names else (*self.role_names, role)
        if len(names) > 31:
            raise ValueError(f"a set of hypotheses knows at most 31 roles, '{role}' is one more")
        chosen = np.zeros(self.role.shape, np.bool_)
        chosen[np.asarray(members)] = True
        bit = np.int32(1 << names.index(role))
        return self._with(role=np.where(chosen, self.role | bit, self.role & ~bit), role_names=names)

    def found_by(self, member: int) -> str:
        """Return the role that says which search found a hypothesis of one population; empty when it has none."""
        return next((r for r in self.role_names if r.startswith(FOUND_BY) and self.has(r)[member]), "")

    @property
    def count(self) -> int:
        """N, the hypotheses per population."""
        return self.values.shape[-2]

    @property
    def dimension(self) -> int:
        """D, the coordinates of a state."""
        return self.values.shape[-1]

    @property
    def evidence_lost(self) -> NDArray[np.bool_]:
        """(*B,) True where no hypothesis of the population has any weight left; its weights are then all
        equal.
        """
        return np.logical_not(np.any(_usable(self.log_weights), axis=-1))

    @cached_property
    def relative_log_weights(self) -> FloatArray:
        """(*B, N) log-weights shifted so that the best is 0; unusable ones -inf; all 0 where the evidence
        is lost.
        """
        usable = _usable(self.log_weights)
        if usable.all():  # as nearly always
            return self.log_weights - self.log_weights.max(axis=-1, keepdims=True)
        log_weights = np.where(usable, self.log_weights, -np.inf)
        peak = log_weights.max(axis=-1, keepdims=True)
        lost = np.isneginf(peak)
        return np.where(lost, 0.0, log_weights - np.where(lost, 0.0, peak))

    @cached_property
    def weights(self) -> FloatArray:
        """Return (*B, N) weights, non-negative, finite and summing to 1; all 1/N where the evidence is lost."""
        weights = np.exp(self.relative_log_weights)
        return weights / weights.sum(axis=-1, keepdims=True)

    @property
    def ess(self) -> FloatArray:
        """Return (*B,) effective number of hypotheses 1 / sum(weights^2), between 1 and N."""
        return 1.0 / np.square(self.weights).sum(axis=-1)

    def reweighted(self, log_likelihood: ArrayLike) -> Hypotheses:
        """The same states after new evidence: log_likelihood (*B, N) is added to the log-weights.

        A population that had lost all evidence starts again from equal weights, so that one blind frame
        cannot silence it for ever. Raises ValueError when the shape is not (*B, N).
        """
        extra = np.asarray(log_likelihood, dtype=np.float64)
        if extra.shape != self.log_weights.shape:
            raise ValueError(f"log-likelihoods must have the shape {self.log_weights.shape}, got {extra.shape}")
        usable = np.where(_usable(extra), extra, -np.inf)
        return self._with(log_weights=self.relative_log_weights + usable)

    def mean(self) -> FloatArray:
        """(*B, D) weighted Euclidean mean. For coordinates that are rotations use
        ``estimates.TangentMean``.
        """
        return np.einsum("...n,...nd->...d", self.weights, self.values)

    def best(self) -> FloatArray:
        """Return (*B, D) the state of largest weight (the first one among equals)."""
        index = self.weights.argmax(axis=-1)[..., None, None]
        return np.take_along_axis(self.values, index, axis=-2)[..., 0, :]

    def scatter(self) -> FloatArray:
        """Return (*B, D, D) weighted covariance of the states around their mean (no small-sample correction)."""
        deviation = self.values - self.mean()[..., None, :]
        return np.einsum("...nd,...ne->...de", self.weights[..., None] * deviation, deviation)

    def spread(self) -> FloatArray:
        """Return (*B, D) weighted standard deviation per coordinate, in the units of the coordinates."""
        deviation = self.values - self.mean()[..., None, :]
        return np.sqrt(np.einsum("...n,...nd->...d", self.weights, np.square(deviation)))

    def take(self, index: ArrayLike) -> Hypotheses:
        """Return the hypotheses at index (*B, M), with their log-weights, origins, roles, covariances and columns."""
        chosen = np.asarray(index, dtype=np.intp)
        return self._with(
            values=_taken(self.values, chosen),
            log_weights=_taken(self.log_weights, chosen),
            origin=_taken(self.origin, chosen),
            role=_taken(self.role, chosen),
            covariance=None if self.covariance is None else _taken(self.covariance, chosen),
            columns={name: _taken(column, chosen) for name, column in self.columns.items()},
        )


_FIELDS = tuple(f.name for f in fields(Hypotheses))


def _equal_log_weights(values: FloatArray) -> FloatArray:
    shape = values.shape[:-1]
    return np.full(shape, -np.log(max(shape[-1], 1)) if shape else 0.0)


def _taken(column: NDArray[Any], chosen: NDArray[np.intp]) -> NDArray[Any]:
    if chosen.ndim == 1:  # one population, as nearly always: the same, sooner
        return column[chosen]
    index = chosen.reshape(*chosen.shape, *(1,) * (column.ndim - chosen.ndim))
    return np.take_along_axis(column, index, chosen.ndim - 1)


def _usable(log_weights: FloatArray) -> NDArray[np.bool_]:
    """Return True where a log-weight is a finite number: -inf is weight 0, NaN and +inf come from a failed
    measurement."""
    return np.isfinite(log_weights)
