"""Branches of steady motions along lines, such as a speed: found from several starts, and followed both ways.

A machine that is not linear may have several steady motions at one place, and what it does depends on how it got
there. From each motion that is found, a search begins at the next place on either side, which is natural continuation
(Allgower and Georg, Introduction to Numerical Continuation Methods, 2003, chapter 2). A step counts if the search back
from its end leads home; else it is halved, as are steps that bring two motions to one. Where no step counts, the branch
has ended, and the machine jumps.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Settle = Callable[[NDArray[np.intp], Array, Array], Array]
#: Difference of two states, over the largest of all starts, below which they are one. It is a convention, far above the
#: errors of coarse steps and far below what tells two stable motions apart.
SAME_MOTION = 1e-3
#: Halvings of the way between two places, after which a branch has ended there; a convention.
MOST_HALVINGS = 5
BEYOND = (math.nan, math.nan)


class Branch(NamedTuple):
    """Steady motions that follow from each other along a line.

    Attributes
    ----------
    line
        The number of the line.
    x, states
        Its places, some in sequence of those of the line, and the states there, shape (places, states).
    ends
        Below the first and above the last place: two places between which the branch ends; nan at the ends of the line.
    """

    line: int
    x: Array
    states: Array
    ends: tuple[tuple[float, float], tuple[float, float]]


def first_of_same(places: Sequence[Hashable], states: Array) -> NDArray[np.bool_]:
    """Return which motions are no other than one before at the same place, shape (n,); those without states count.

    A search with other steps may come from a branch to another.
    """
    scale = np.nanmax(np.abs(states), axis=0, initial=0.0)
    known: dict[Hashable, list[Array]] = {}
    is_first = np.ones(len(states), bool)
    for k, (place, state) in enumerate(zip(places, states)):
        others = known.setdefault(place, [])
        is_first[k] = not any((np.abs(state - x) <= SAME_MOTION * scale).all() for x in others)
        others.append(state)
    return is_first


class _Motion(NamedTuple):
    """A motion by its place and its number there."""

    place: int
    number: int


class _Walk(NamedTuple):
    """A walk from a motion to a place beside it: it has come to `at`, and tries steps of this share of the way."""

    motion: _Motion
    to: int
    states: Array
    at: float = 0.0
    share: float = 1.0
    longest: float = 1.0

    @property
    def next(self) -> float:
        """Where the next step ends, as a share of the way."""
        return min(1.0, self.at + self.share)


def follow_branches(settle: Settle, lines: Sequence[Array], starts: Array) -> list[Branch]:
    """Return all branches of the stable motions that starts lead to, by line and first place.

    Parameters
    ----------
    settle : callable
        Takes numbers of lines and places on them, shape (n,), and states, shape (n, states); returns the states of the
        stable motions to which they lead, nan where to none.
    lines : sequence of ndarray
        The places of each line, rising.
    starts : ndarray, shape (starts, places, states)
        States from which motions are sought at all places, those of one line after the other.
    """
    return sorted(_Search(settle, lines, starts).branches(), key=lambda b: (b.line, b.x[0]))


class _Search:
    """The motions at all places, to which others they lead, and where no step counts."""

    def __init__(self, settle: Settle, lines: Sequence[Array], starts: Array) -> None:
        self.settle = settle
        self.line = np.repeat(np.arange(len(lines)), [len(x) for x in lines])
        self.x, self.scale = np.concatenate(lines), np.abs(starts).max((0, 1))
        self.motions: list[list[Array]] = [[] for _ in self.x]
        self.links: dict[tuple[_Motion, int], _Motion] = {}
        self.ends: dict[tuple[_Motion, int], tuple[float, float]] = {}
        every = np.tile(np.arange(len(self.x)), len(starts))
        found = settle(self.line[every], self.x[every], starts.reshape(len(every), -1))
        walks = self.meet(every.tolist(), found)
        longest = 1.0
        while walks and longest > 0.5**MOST_HALVINGS:
            while walks:
                walks = self.walk(walks)
            longest /= 2.0
            walks = [
                _Walk(m, to, self.motions[m.place][m.number], 0.0, longest, longest)
                for m, to in self.doubtful()
            ]

    def meet(self, places: Sequence[int], states: Sequence[Array] | Array) -> list[_Walk]:
        """Take motions that searches have come to, and return walks from the new ones to both sides."""
        walks = []
        for place, state in zip(places, states):
            if np.isnan(state).any() or self.number(place, state) is not None:
                continue
            self.motions[place].append(state)
            motion = _Motion(place, len(self.motions[place]) - 1)
            sides = [k for k in (place - 1, place + 1) if 0 <= k < len(self.x)]
            walks += [_Walk(motion, k, state) for k in sides if self.line[k] == self.line[place]]
        return walks

    def number(self, place: int, state: Array) -> int | None:
        """The number of a motion among those at its place."""
        known = (k for k, y in enumerate(self.motions[place]) if self.is_same(y, state))
        return next(known, None)

    def is_same(self, states: Array, others: Array) -> bool:
        """Whether two motions are one."""
        return bool((np.abs(states - others) <= SAME_MOTION * self.scale).all())

    def between(self, walk: _Walk, share: float) -> float:
        """The place at a share of the way of a walk."""
        first, last = self.x[walk.motion.place], self.x[walk.to]
        return float(last if share == 1.0 else first + share * (last - first))

    def walk(self, walks: list[_Walk]) -> list[_Walk]:
        """Take a step of each walk, and return those that go on, and those from motions that they have met."""
        line = self.line[[w.to for w in walks]]
        at, to = (np.array([self.between(w, y) for w, y in pairs]) for pairs in (
            [(w, w.at) for w in walks], [(w, w.next) for w in walks]))  # fmt: skip
        there = self.settle(line, to, np.array([w.states for w in walks]))
        home = self.settle(line, at, there)
        arrived = [(w.to, y) for w, y in zip(walks, there) if w.next == 1.0]
        going = self.meet(*zip(*arrived)) if arrived else []
        for w, states, back in zip(walks, there, home):
            if self.is_same(back, w.states):
                if w.next == 1.0:
                    self.links[w.motion, w.to] = _Motion(w.to, self.number(w.to, states) or 0)
                else:
                    share = min(2.0 * w.share, w.longest)
                    going.append(w._replace(states=states, at=w.next, share=share))
            elif w.share > 0.5**MOST_HALVINGS:
                going.append(w._replace(share=w.share / 2.0))
            else:
                self.ends[w.motion, w.to] = self.between(w, w.at), self.between(w, w.next)
        return going

    def doubtful(self) -> list[tuple[_Motion, int]]:
        """Take back links that are not mutual, or bring two motions to one, and return from where and to where."""
        arrivals = Counter((end, motion.place) for (motion, _), end in self.links.items())
        doubtful = set()
        for (motion, to), end in self.links.items():
            if self.links.get((end, motion.place)) != motion or arrivals[end, motion.place] > 1:
                doubtful |= {(motion, to), (end, motion.place)}
        for key in doubtful:
            self.links.pop(key, None)
            self.ends.pop(key, None)
        return sorted(doubtful)

    def branches(self) -> Iterator[Branch]:
        """Yield the motions of each branch."""
        after = {motion: end for (motion, to), end in self.links.items() if to > motion.place}
        for motion in sorted(
            {_Motion(k, j) for k, y in enumerate(self.motions) for j in range(len(y))}
            - set(after.values())
        ):
            chain = [motion]
            while chain[-1] in after:
                chain.append(after[chain[-1]])
            places = [m.place for m in chain]
            below, above = (
                self.ends.get((m, m.place + side), BEYOND)
                for m, side in ((chain[0], -1), (chain[-1], 1))
            )
            states = np.array([self.motions[m.place][m.number] for m in chain])
            ends = (below[::-1], above)
            yield Branch(int(self.line[motion.place]), self.x[places], states, ends)
