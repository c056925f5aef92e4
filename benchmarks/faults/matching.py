"""Depth maps reused between rows: the same images give the same depth map."""

from __future__ import annotations

import hashlib
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.pipeline.reconstructing import checked_matcher
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor

Cache = dict[tuple[bytes, tuple[str, ...]], DepthMap | ReconstructionError]


class CachedMatcher:
    """A matcher for a set of auxiliaries that computes the depth of the same images once."""

    def __init__(self, matcher: Any, names: tuple[str, ...], cache: Cache) -> None:
        self._matcher, self._names, self._cache = matcher, names, cache

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        """Return the depth of a frame."""
        key = _hash_images(frame_set), self._names
        if key not in self._cache:
            try:
                self._cache[key] = self._matcher.reconstruct(frame_set, reporter)
            except ReconstructionError as error:
                self._cache[key] = error
        found = self._cache[key]
        if isinstance(found, ReconstructionError):
            raise found
        return found


@contextmanager
def use_cache(cache: Cache) -> Generator[None]:
    """Let the live system's matchers share a cache."""

    def make(*words: Any, auxiliaries: tuple[str, ...], **options: Any) -> CachedMatcher:
        matcher = MultiviewReconstructor(*words, auxiliaries=auxiliaries, **options)
        return CachedMatcher(matcher, auxiliaries, cache)

    module: Any = checked_matcher
    module.MultiviewReconstructor = make
    try:
        yield
    finally:
        module.MultiviewReconstructor = MultiviewReconstructor


def _hash_images(frame_set: FrameSet) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for name in sorted(frame_set.images):
        digest.update(name.encode())
        digest.update(frame_set.images[name].tobytes())
    return digest.digest()
