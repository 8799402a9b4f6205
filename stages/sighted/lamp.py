"""The track of a lamp through a recording: of all bright spots those that move as one, chosen by dynamic programming.

A spot that is there for a long time at one place, or that returns to it again and again, is a fixed lamp that was switched on,
that flickers, or a digit of a clock.  Of the others, the path with the brightest spots is taken that jumps as seldom as possible:
a lamp that is carried through the views is seen longer than the headlights of a car, is brighter than its reflection on wet
ground, and smaller than a person in bright clothes.

One spot a frame is given, though a second candidate is sometimes right: the solver bears some wrong rows well, but a second
row in every frame, a reflection that moves with the lamp, would be as consistent as the lamp itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..types import Bools, Float64s, Int32s, Int64s, Uint8s
from .boards import spread_over
from .rows import Rows
from .spots import Background, Spots, brightest_channel, find_spots
from .video import Recording

_SAMPLE = 12
"""Frames, spread over the recording, whose median is the background; up to twice as many are taken."""
_SAME_PLACE_PX = 4.0
"""Side of the cells in which spots are at the same place."""
_MOST_RETURNS = 4
"""Times that a spot may be seen at one place, with others between them, before it is a fixed lamp that flickers."""
_APART_S = 1.0
"""Time without it after which a spot returns."""
_LONGEST_STAY_S = 8.0
_LONGEST_STAY_SHARE = 0.25
"""Time, and share of the recording, from which on a spot at one place is a fixed lamp that was switched on: the longer one."""
_FULL_CONTRAST = 80.0
"""Light above that of its surroundings from which on a spot stands out as much as a lamp can."""
_FULL_LEVEL = (20.0, 230.0)
"""Light of a spot that is as dark as the ground at night, and of one that is as bright as a lamp; 255 is the brightest."""
_LARGE_SHARE = 0.02
"""Radius of a spot, as a share of the picture's larger side, that counts half: lit clothes and walls are larger."""
_SLACK_SHARE = 0.015
_SPEED_SHARE = 0.1
"""Distance from where a lamp is expected that costs as much as a bright spot gains: a share of the picture's larger side, and
such a share for each second since it was seen."""
_GOES_ON_S = 0.5
"""Time for which a lamp is expected to go on as before."""
_JUMP_COST = 6.0
"""Cost of leaving one track for another, in frames with a bright spot."""
_MOST_GAP_S = 1.5
"""Longest time for which a lamp may be hidden (or be off, if it blinks) and still be on the same track."""
_LEAST_PIECE = 5
"""Fewest spots of a piece of the path between jumps."""
_LEAST_WAY_SHARE = 0.02
"""Extent of the path, as a share of the picture's larger side, at least: a lamp that stays where it is, is not carried."""
_PAUSE_S = 3.0
"""Time from which on a spot that stays where it is counts less than one that moves: somebody stops, or a light is switched on."""
_PAUSE_REWARD = 0.3
"""What it counts then."""
_ALIKE = 0.45
"""Median reward of a few spots of the path that follow each other, over the upper quartile of all, at least."""
_NEIGHBOURS = 7
"""Number of these spots."""
_JUMP_SHARE = 0.15
"""Way between two spots, as a share of the picture's larger side, that divides a path."""
_LEAST_REWARD = 0.35
"""Upper quartile of the rewards of a path, at least: clothes and walls that something lights are no lamp."""


@dataclass(frozen=True)
class LampFound:
    """What a recording shows of a lamp."""

    rows: Rows
    frames: int
    """Number of frames that were searched."""
    frames_with_spots: int
    """Frames with any bright spot that the background does not have."""
    picture: Uint8s
    """(h, w, 3) uint8 BGR: the background."""


def find_lamp(recording: Recording, most_per_s: float) -> LampFound:
    """The track of the lamp in a recording.  Raises BadCapture.

    most_per_s: frames of a second that are enough.
    """
    sample = spread_over((frame.image for frame in recording.frames(most_per_s)), _SAMPLE)
    picture = np.partition(np.stack(sample), len(sample) // 2, axis=0)[len(sample) // 2]
    background = Background.of_levels([brightest_channel(image) for image in sample])
    times: list[float] = []
    spots: list[Spots] = []
    for frame in recording.frames(most_per_s):
        times.append(frame.time)
        spots.append(find_spots(brightest_channel(frame.image), background))
    rows = lamp_track(np.array(times), spots, max(recording.size))
    return LampFound(rows, len(times), sum(len(each.xy) > 0 for each in spots), picture)


@dataclass(frozen=True)
class _Candidates:
    """The spots of all frames, in the order of time."""

    frame: Int32s
    """(n,) int32 number of the frame."""
    times: Float64s
    xy: Float64s
    reward: Float64s
    """(n,) 0 to 1: how much a spot looks like a lamp."""
    sigma_px: Float64s

    def chosen(self, which: Bools) -> _Candidates:
        """Some of them."""
        return _Candidates(self.frame[which], self.times[which], self.xy[which], self.reward[which], self.sigma_px[which])


def lamp_track(times: Float64s, spots: Sequence[Spots], side: int) -> Rows:
    """The spots that are the lamp; none, if nothing bright moves.

    times: (frames,) float64 seconds, ascending.  spots: of each frame.  side: larger side of the picture, pixels.
    """
    candidates = _candidates(times, spots, side)
    if len(candidates.frame) == 0:
        return Rows.none()
    is_fixed, is_still = _stationary(candidates, float(times[-1] - times[0]))
    counted = np.where(is_still, _PAUSE_REWARD, 1.0) * candidates.reward
    candidates = replace(candidates, reward=counted).chosen(~is_fixed)
    path = _like_the_rest(candidates, np.sort(np.concatenate([np.zeros(0, np.int32), *_best_path(candidates, side)])))
    pieces = [piece for piece in _cut(candidates, path, side) if _is_lamp(candidates, piece, side)]
    if not pieces:
        return Rows.none()
    path = np.concatenate(pieces)
    xy = candidates.xy[path]
    return Rows(candidates.times[path], np.zeros(len(path), np.int32), xy, candidates.sigma_px[path])


def _candidates(times: Float64s, spots: Sequence[Spots], side: int) -> _Candidates:
    """The spots of all frames, with what each would add to a path."""
    counts = [len(each.xy) for each in spots]
    frame = np.repeat(np.arange(len(spots), dtype=np.int32), counts)
    rewards = [_reward(each, side) for each in spots]
    return _Candidates(
        frame,
        times[frame],
        np.concatenate([np.zeros((0, 2)), *(each.xy for each in spots)]),
        np.concatenate([np.zeros(0), *rewards]),
        np.concatenate([np.zeros(0), *(each.sigma_px for each in spots)]),
    )


def _reward(spots: Spots, side: int) -> Float64s:
    """(n,) float64 0 to 1: bright, small, round, and brighter than what else is bright in this frame."""
    if len(spots.xy) == 0:
        return np.zeros(0)
    dark, bright = _FULL_LEVEL
    brightness = np.clip(spots.contrast / _FULL_CONTRAST, 0.0, 1.0) * np.clip((spots.level - dark) / (bright - dark), 0.1, 1.0)
    smallness = 1.0 / (1.0 + (spots.radius / (_LARGE_SHARE * side)) ** 2)
    # a reflection is as bright as the lamp where both are too bright for the sensor, but not as large
    rank = 0.6 + 0.4 * spots.flux / spots.flux.max()
    return np.asarray(brightness * smallness * spots.roundness * rank, np.float64)


def _like_the_rest(candidates: _Candidates, path: Int32s) -> Int32s:
    """A path without its parts that look less like a lamp than most of it: what it follows while the lamp is hidden.

    Nothing is left of one that shows no lamp at all.
    """
    reward = candidates.reward[path]
    if len(path) == 0 or np.percentile(reward, 75) < _LEAST_REWARD:
        return path[:0]
    half = _NEIGHBOURS // 2
    around = np.lib.stride_tricks.sliding_window_view(np.pad(reward, half, mode="edge"), 2 * half + 1)
    return path[np.median(around, axis=1) >= _ALIKE * np.percentile(reward, 75)]


def _cut(candidates: _Candidates, path: Int32s, side: int) -> list[Int32s]:
    """A path in pieces: cut where the lamp is not seen for long, or jumps."""
    seconds = np.diff(candidates.times[path])
    ways = np.linalg.norm(np.diff(candidates.xy[path], axis=0), axis=1)
    is_cut = (seconds > _MOST_GAP_S) | (ways > _JUMP_SHARE * side)
    return np.split(path, np.flatnonzero(is_cut) + 1)


def _is_lamp(candidates: _Candidates, piece: Int32s, side: int) -> bool:
    """Is a piece of the path long enough, and does it lead anywhere?"""
    if len(piece) < _LEAST_PIECE:
        return False
    return bool(np.ptp(candidates.xy[piece], axis=0).max() >= _LEAST_WAY_SHARE * side)


def _stationary(candidates: _Candidates, seconds: float) -> tuple[Bools, Bools]:
    """Spots at places that are lit again and again, or for long; and those that pause.  Both (n,) bool.

    seconds: length of the recording.
    """
    is_fixed = np.zeros(len(candidates.frame), np.bool_)
    is_still = is_fixed.copy()
    longest_s = max(_LONGEST_STAY_S, _LONGEST_STAY_SHARE * seconds)
    # in cells of four grids: any place is near the middle of a cell of one of them
    for shift in ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5)):
        places = np.floor(candidates.xy / _SAME_PLACE_PX + shift).astype(np.int64)
        _, cell = np.unique(places, axis=0, return_inverse=True)
        cell = cell.ravel()
        stays, longest = _stays(cell, candidates.times)
        is_fixed |= ((stays > _MOST_RETURNS) | (longest >= longest_s))[cell]
        is_still |= (longest >= _PAUSE_S)[cell]
    return is_fixed, is_still


def _stays(cell: npt.NDArray[np.intp], times: Float64s) -> tuple[Int64s, Float64s]:
    """For each cell, how often spots stayed in it, and the longest of these stays in seconds; both (cells,)."""
    order = np.lexsort((times, cell))
    cell = cell[order]
    times = times[order]
    begins = np.append(True, (np.diff(cell) != 0) | (np.diff(times) > _APART_S))
    firsts = np.flatnonzero(begins)
    lasts = np.append(firsts[1:], len(cell)) - 1
    cells = int(cell[-1]) + 1
    longest = np.zeros(cells)
    np.maximum.at(longest, cell[firsts], times[lasts] - times[firsts])
    return np.bincount(cell[firsts], minlength=cells), longest


def _best_path(candidates: _Candidates, side: int) -> list[Int32s]:
    """Numbers of the candidates on the path that adds up the most, at most one a frame; in pieces between jumps."""
    count = len(candidates.frame)
    score = np.zeros(count)
    before = np.full(count, -1, np.int32)
    is_jump = np.zeros(count, np.bool_)
    velocity = np.zeros((count, 2))
    starts = np.searchsorted(candidates.frame, candidates.frame, side="left")
    oldest = np.searchsorted(candidates.times, candidates.times - _MOST_GAP_S, side="left")
    # number of the best candidate of all earlier frames; -1: there is none
    champion = -1
    for k in range(count):
        first = int(starts[k])
        # 1. A new track, after the best path so far.
        if k == first and k > 0:
            previous = int(starts[k - 1]) + int(np.argmax(score[starts[k - 1] : k]))
            if champion < 0 or score[previous] > score[champion]:
                champion = previous
        best = 0.0
        if champion >= 0 and score[champion] - _JUMP_COST > 0:
            best = float(score[champion]) - _JUMP_COST
            before[k] = champion
        is_jump[k] = True

        # 2. The same track as a spot shortly before.
        recent = np.arange(oldest[k], first)
        if len(recent):
            seconds = candidates.times[k] - candidates.times[recent]
            # from where it would be if it went on as before; of a track that has just begun, this is not known
            expected = candidates.xy[recent] + velocity[recent] * np.minimum(seconds, _GOES_ON_S)[:, None]
            way = np.linalg.norm(candidates.xy[k] - expected, axis=1)
            totals = score[recent] - (way / (side * (_SLACK_SHARE + _SPEED_SHARE * seconds))) ** 2
            if totals.max() > best:
                best = float(totals.max())
                before[k] = recent[int(totals.argmax())]
                is_jump[k] = False
                step = candidates.xy[k] - candidates.xy[before[k]]
                velocity[k] = step / (candidates.times[k] - candidates.times[before[k]])
        score[k] = best + candidates.reward[k]
    return _pieces(score, before, is_jump)


def _pieces(score: Float64s, before: Int32s, is_jump: Bools) -> list[Int32s]:
    """The path that ends with the highest score, in pieces between jumps."""
    pieces: list[Int32s] = []
    piece: list[int] = []
    k = int(np.argmax(score)) if len(score) else -1
    while k >= 0:
        piece.append(k)
        if is_jump[k]:
            pieces.append(np.array(piece, np.int32))
            piece = []
        k = int(before[k])
    return pieces
