"""Similarity of whole views, from one vector for each, so that only promising pairs of many views need a closer look.

A view's vector holds, for each of a few visual words, the sum of its descriptors' residuals from the word (VLAD; Jegou, Douze,
Schmid, Perez, Aggregating local descriptors into a compact image representation, CVPR 2010), scaled to unit length for each word
(Arandjelovic, Zisserman, All about VLAD, CVPR 2013).  The words are clusters of the site's own descriptors: nothing has to be
learnt beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..types import Float32s

_WORDS = 32
"""Number of visual words: the best of 16, 32 and 64 on two photographed sites; a vocabulary of a thousand words, or votes of
single descriptors, find no more."""
_SAMPLE_SIZE, _ROUNDS = 12_000, 8
"""Number of descriptors that the words are clustered from, and rounds of k-means."""


def most_similar(descriptors: Sequence[Float32s], count: int) -> list[tuple[int, int]]:
    """Pairs (i, j) of views, i < j, in which one view is among the `count` most similar to the other; in order.

    descriptors: (n, d) float32 of unit length, of each view.
    """
    vectors = _view_vectors(descriptors)
    similarity = vectors @ vectors.T
    np.fill_diagonal(similarity, -np.inf)
    count = min(count, len(descriptors) - 1)
    best = np.argsort(-similarity, axis=1, kind="stable")[:, :count]
    rows = np.repeat(np.arange(len(descriptors)), count)
    pairs = np.sort(np.column_stack([rows, best.ravel()]), axis=1)
    return [(int(i), int(j)) for i, j in np.unique(pairs, axis=0)]


def _view_vectors(descriptors: Sequence[Float32s]) -> Float32s:
    """(views, words d) vectors of unit length, 0 for views without descriptors."""
    all_descriptors = np.concatenate(descriptors)
    words = _words(all_descriptors, np.random.default_rng(0))
    sums = np.zeros((len(descriptors), *words.shape), np.float32)
    for row, view_descriptors in zip(sums, descriptors, strict=True):
        nearest = (view_descriptors @ words.T).argmax(axis=1)
        np.add.at(row, nearest, view_descriptors - words[nearest])
        row /= np.maximum(np.linalg.norm(row, axis=1, keepdims=True), 1e-9)
    flat = sums.reshape(len(descriptors), -1)
    return np.asarray(flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9), dtype=np.float32)


def _words(all_descriptors: Float32s, random: np.random.Generator) -> Float32s:
    """(words, d) of unit length, by spherical k-means on a sample of the descriptors."""
    sample = all_descriptors[np.sort(random.choice(len(all_descriptors), min(len(all_descriptors), _SAMPLE_SIZE), replace=False))]
    words = sample[random.choice(len(sample), min(_WORDS, len(sample)), replace=False)].copy()
    for _ in range(_ROUNDS):
        nearest = (sample @ words.T).argmax(axis=1)
        sums = np.zeros_like(words)
        np.add.at(sums, nearest, sample)
        length = np.linalg.norm(sums, axis=1, keepdims=True)
        words = np.where(length > 0, sums / np.maximum(length, 1e-9), words)
    return words
