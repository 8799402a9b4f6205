"""Which views look alike as wholes: one vector for each, so that of many views only promising pairs need a closer look.

A view's vector holds, for each of a few visual words, the direction in which its descriptors lie off the word (VLAD; Jegou,
Douze, Schmid, Perez, Aggregating local descriptors into a compact image representation, CVPR 2010), each word's share of unit
length (Arandjelovic, Zisserman, All about VLAD, CVPR 2013).  Words are the means of the site's own descriptors: nothing has to be
learnt beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..types import Float32s

_WORDS = 32
"""Of 16, 32 and 64 the one that finds most on two photographed sites; a vocabulary of a thousand words, and votes of single
descriptors, find no more."""
_LEARNT_FROM, _ROUNDS = 12_000, 8
"""Descriptors from which words are made, and rounds of making them."""


def most_alike(descriptors: Sequence[Float32s], count: int) -> list[tuple[int, int]]:
    """Pairs (i, j) of views, i < j, of which one is among the `count` that look most like the other; in order.

    descriptors: (n, d) float32 of unit length, of each view.
    """
    whole = _whole_views(descriptors)
    likeness = whole @ whole.T
    np.fill_diagonal(likeness, -np.inf)
    count = min(count, len(descriptors) - 1)
    best = np.argsort(-likeness, axis=1, kind="stable")[:, :count]
    rows = np.repeat(np.arange(len(descriptors)), count)
    pairs = np.sort(np.column_stack([rows, best.ravel()]), axis=1)
    return [(int(i), int(j)) for i, j in np.unique(pairs, axis=0)]


def _whole_views(descriptors: Sequence[Float32s]) -> Float32s:
    """(views, words d) of unit length, or 0 where a view has no descriptors."""
    every = np.concatenate(descriptors)
    words = _words(every, np.random.default_rng(0))
    found = np.zeros((len(descriptors), *words.shape), np.float32)
    for row, own in zip(found, descriptors, strict=True):
        word = (own @ words.T).argmax(axis=1)
        np.add.at(row, word, own - words[word])
        row /= np.maximum(np.linalg.norm(row, axis=1, keepdims=True), 1e-9)
    flat = found.reshape(len(descriptors), -1)
    return np.asarray(flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9), dtype=np.float32)


def _words(every: Float32s, random: np.random.Generator) -> Float32s:
    """(words, d) of unit length: spherical k-means of some of the descriptors."""
    some = every[np.sort(random.choice(len(every), min(len(every), _LEARNT_FROM), replace=False))]
    words = some[random.choice(len(some), min(_WORDS, len(some)), replace=False)].copy()
    for _ in range(_ROUNDS):
        nearest = (some @ words.T).argmax(axis=1)
        sums = np.zeros_like(words)
        np.add.at(sums, nearest, some)
        length = np.linalg.norm(sums, axis=1, keepdims=True)
        words = np.where(length > 0, sums / np.maximum(length, 1e-9), words)
    return words
