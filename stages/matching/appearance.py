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
"""Number of visual words (measured on two photographed sites: 16 and 64 find fewer overlapping views)."""
_SAMPLE_SIZE = 12_000
"""Number of descriptors that the words are clustered from."""
_ROUNDS = 8
"""Rounds of k-means."""


def most_similar(descriptors: Sequence[Float32s], count: int) -> list[tuple[int, int]]:
    """Pairs (i, j) of views, i < j, in which one view is among the `count` most similar to the other; in order.

    descriptors: (n, d) float32 of unit length, of each view.
    """
    vectors = _view_vectors(descriptors)
    similarity = vectors @ vectors.T
    np.fill_diagonal(similarity, -np.inf)
    count = min(count, len(descriptors) - 1)
    # each view's own best; sorted and made unique, since two views may choose each other
    best = np.argsort(-similarity, axis=1, kind="stable")[:, :count]
    rows = np.repeat(np.arange(len(descriptors)), count)
    pairs = np.sort(np.column_stack([rows, best.ravel()]), axis=1)
    return [(int(i), int(j)) for i, j in np.unique(pairs, axis=0)]


def _view_vectors(descriptors: Sequence[Float32s]) -> Float32s:
    """(views, words d) vectors of unit length, 0 for views without descriptors."""
    all_descriptors = np.concatenate(descriptors)
    words = _words(all_descriptors, np.random.default_rng(0))
    sums = np.zeros((len(descriptors), *words.shape), np.float32)
    # row: (words, d) sums of the residuals of one view
    for row, view_descriptors in zip(sums, descriptors, strict=True):
        nearest = (view_descriptors @ words.T).argmax(axis=1)
        np.add.at(row, nearest, view_descriptors - words[nearest])
        # each word with unit length, so that one that is seen again and again does not outweigh the others
        row /= np.maximum(np.linalg.norm(row, axis=1, keepdims=True), 1e-9)
    flat = sums.reshape(len(descriptors), -1)
    return np.asarray(flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9), dtype=np.float32)


def _words(all_descriptors: Float32s, random: np.random.Generator) -> Float32s:
    """(words, d) of unit length, by spherical k-means on a sample of the descriptors."""
    sample_size = min(len(all_descriptors), _SAMPLE_SIZE)
    sample_rows = random.choice(len(all_descriptors), sample_size, replace=False)
    sample = all_descriptors[np.sort(sample_rows)]
    first_words = random.choice(len(sample), min(_WORDS, len(sample)), replace=False)
    words = sample[first_words].copy()
    for _ in range(_ROUNDS):
        nearest = (sample @ words.T).argmax(axis=1)
        sums = np.zeros_like(words)
        np.add.at(sums, nearest, sample)
        length = np.linalg.norm(sums, axis=1, keepdims=True)
        # a word without descriptors stays where it is
        words = np.where(length > 0, sums / np.maximum(length, 1e-9), words)
    return words
