"""Weighted set of hypotheses: the value that every tracker moves, weighs, resamples and reads.

Weights are kept as logarithms, up to a common factor per population, so that adding evidence never under- or overflows.
Two integer columns are inherited by resampling: `origin`, where a hypothesis comes from, and `role`, what it is. A
survival rate is therefore a histogram of a column, and no method needs hidden state or a particular row.
Source: Alcoverro 2014, section 2.2.1 (weighted particle set, eq. 2.5); batch axes for the swarm of Asteriadis et al.
    2013.
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
"""Name of the column with the state (D,) that each hypothesis had one step ago."""
FOUND_BY = "by "
"""Prefix of the role that names the search by which a hypothesis was found, such as `by limb search`."""


@dataclass(frozen=True)
class Hypotheses:
    """Immutable set of N weighted states per population; every operation returns a new set.

    values: (*B, N, D) states, in the units of the caller; *B are any number of batch axes (populations).
    log_weights: (*B, N), up to a constant per population; NaN and +inf count as weight 0.
    origin: (*B, N) number of the sensor, kernel or parent that a hypothesis comes from; one number stands for all.
    role: (*B, N) bit mask, bit k stands for role_names[k]; one number stands for all. Read it with `has`, write it with
        `marked`.
    role_names: names of the roles, at most 31.
    columns: further arrays (*B, N, ...) by name, one row per hypothesis (a velocity, a cost, a covariance).
    Raises: ValueError where shapes do not agree or a population is empty.
    """

    values: FloatArray
    log_weights: FloatArray
    origin: _IntArray = field(default_factory=lambda: np.zeros((), np.int32))
    role: _IntArray = field(default_factory=lambda: np.zeros((), np.int32))
    role_names: tuple[str, ...] = ()
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
        for name, column in self.columns.items():
            if column.shape[: log_weights.ndim] != log_weights.shape:
                raise ValueError(f"the column '{name}' {column.shape} needs one row per hypothesis {log_weights.shape}")

    @staticmethod
    def uniform(values: ArrayLike, origin: ArrayLike = 0) -> Hypotheses:
        """Make a set of equal weights 1/N from states.

        values: (*B, N, D) states.
        origin: (*B, N) number of the sensor, kernel or parent of each hypothesis, or one number for all.
        """
        states = np.asarray(values, dtype=np.float64)
        shape = states.shape[:-1]
        return Hypotheses(states, np.full(shape, -np.log(max([1, *shape[-1:]]))), np.asarray(origin, np.int32))

    def equal(self, values: FloatArray | None = None) -> Hypotheses:
        """Return the same hypotheses with equal weights 1/N, at other values (*B, N, D) where given."""
        equal = np.full(self.log_weights.shape, -np.log(self.count))
        return (self if values is None else self.at(values))._with(log_weights=equal)

    def at(self, values: FloatArray) -> Hypotheses:
        """Return the same hypotheses at other values (*B, N, D)."""
        assert values.shape == self.values.shape and values.dtype == np.float64
        return self._with(values=values)

    def _with(self, **changed: Any) -> Hypotheses:
        """Copy the set with some fields replaced, without the checks of `dataclasses.replace`: it is called often per
        frame.
        """
        out = object.__new__(Hypotheses)
        for name in _FIELDS:
            object.__setattr__(out, name, changed.get(name, getattr(self, name)))
        return out

    def has(self, role: str) -> NDArray[np.bool_]:
        """Find the hypotheses in a role.

        Returns: (*B, N) bool; False everywhere for an unknown role.
        """
        if role not in self.role_names:
            return np.zeros(self.role.shape, np.bool_)
        return (self.role >> self.role_names.index(role) & 1).astype(np.bool_)

    def marked(self, role: str, members: ArrayLike) -> Hypotheses:
        """Return the set with a role given to some hypotheses and taken from all others.

        role: name of the role; a new name is added.
        members: (*B, N) bool, or the indices of the hypotheses.
        Raises: ValueError where it would be the 32nd role.
        """
        names = self.role_names if role in self.role_names else (*self.role_names, role)
        if len(names) > 31:
            raise ValueError(f"a set of hypotheses has at most 31 roles, '{role}' would be one more")
        chosen = np.zeros(self.role.shape, np.bool_)
        chosen[np.asarray(members)] = True
        bit = np.int32(1 << names.index(role))
        return self._with(role=np.where(chosen, self.role | bit, self.role & ~bit), role_names=names)

    def found_by(self, member: int) -> str:
        """Return the name of the search that found a hypothesis, of a set with one population.

        member: index of the hypothesis.
        Returns: its first role that begins with FOUND_BY, such as "by limb search"; "" where it has no such role.
        """
        return next((r for r in self.role_names if r.startswith(FOUND_BY) and self.has(r)[member]), "")

    @property
    def count(self) -> int:
        """Number N of hypotheses per population."""
        return self.values.shape[-2]

    @cached_property
    def relative_log_weights(self) -> FloatArray:
        """(*B, N) log-weights relative to the best, which is 0; -inf for weight 0; all 0 where the evidence is lost."""
        usable = np.isfinite(self.log_weights)
        if usable.all():  # the usual case
            return self.log_weights - self.log_weights.max(axis=-1, keepdims=True)
        log_weights = np.where(usable, self.log_weights, -np.inf)
        peak = log_weights.max(axis=-1, keepdims=True)
        lost = np.isneginf(peak)
        return np.where(lost, 0.0, log_weights - np.where(lost, 0.0, peak))

    @cached_property
    def weights(self) -> FloatArray:
        """(*B, N) weights, non-negative, finite and summing to 1; all 1/N where the evidence is lost."""
        weights = np.exp(self.relative_log_weights)
        return weights / weights.sum(axis=-1, keepdims=True)

    def reweighted(self, log_likelihood: ArrayLike) -> Hypotheses:
        """Add the log-likelihoods of new evidence to the log-weights.

        log_likelihood: (*B, N); NaN and +inf count as weight 0.
        Raises: ValueError where the shape is not (*B, N).
        Why: a population that had lost all evidence starts again from equal weights, so that one frame without evidence
        does not disable it for ever.
        """
        extra = np.asarray(log_likelihood, dtype=np.float64)
        if extra.shape != self.log_weights.shape:
            raise ValueError(f"log-likelihoods must have the shape {self.log_weights.shape}, got {extra.shape}")
        usable = np.where(np.isfinite(extra), extra, -np.inf)
        return self._with(log_weights=self.relative_log_weights + usable)

    def mean(self) -> FloatArray:
        """Compute the weighted Euclidean mean (*B, D); for rotations use `estimates.tangent_mean`."""
        return np.einsum("...n,...nd->...d", self.weights, self.values)

    def best(self) -> FloatArray:
        """Return the state (*B, D) of largest weight (the first one among equals)."""
        index = self.weights.argmax(axis=-1)[..., None, None]
        return np.take_along_axis(self.values, index, axis=-2)[..., 0, :]

    def scatter(self) -> FloatArray:
        """Compute the weighted covariance (*B, D, D) of the states around their mean (no small-sample correction)."""
        deviation = self.values - self.mean()[..., None, :]
        return np.einsum("...nd,...ne->...de", self.weights[..., None] * deviation, deviation)

    def spread(self) -> FloatArray:
        """Compute the weighted standard deviation (*B, D) of each coordinate, in the units of the coordinates."""
        deviation = self.values - self.mean()[..., None, :]
        return np.sqrt(np.einsum("...n,...nd->...d", self.weights, np.square(deviation)))

    def take(self, index: ArrayLike) -> Hypotheses:
        """Select hypotheses by index (*B, M), with their log-weights, origins, roles and columns."""
        chosen = np.asarray(index, dtype=np.intp)
        return self._with(
            values=_taken(self.values, chosen),
            log_weights=_taken(self.log_weights, chosen),
            origin=_taken(self.origin, chosen),
            role=_taken(self.role, chosen),
            columns={name: _taken(column, chosen) for name, column in self.columns.items()},
        )


_FIELDS = tuple(f.name for f in fields(Hypotheses))


def _taken(column: NDArray[Any], chosen: NDArray[np.intp]) -> NDArray[Any]:
    """Select rows of a column (*B, N, ...) by index (*B, M)."""
    if chosen.ndim == 1:  # one population, the usual case: the same result, faster
        return column[chosen]
    index = chosen.reshape(*chosen.shape, *(1,) * (column.ndim - chosen.ndim))
    return np.take_along_axis(column, index, chosen.ndim - 1)
