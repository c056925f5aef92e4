"""Depth maps reused between rows: the same images give the same depth map."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter

Cache = dict[tuple[bytes, tuple[str, ...]], DepthMap | ReconstructionError]


class CachedMatcher:
    """A matcher for a set of auxiliaries that computes the depth of the same images once.

    The prior, which only shortens the search, is that of the first time.
    """

    def __init__(self, matcher: Any, names: tuple[str, ...], cache: Cache) -> None:
        self._matcher, self._names, self._cache = matcher, names, cache

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter, *, prior: Any = None) -> DepthMap:
        """Return the depth of a frame."""
        key = _hash_images(frame_set), self._names
        if key not in self._cache:
            try:
                self._cache[key] = self._matcher.reconstruct(frame_set, reporter, prior=prior)
            except ReconstructionError as error:
                self._cache[key] = error
        found = self._cache[key]
        if isinstance(found, ReconstructionError):
            raise found
        return found


def share_cache(
    make_matcher: Callable[[tuple[str, ...]], Any], cache: Cache
) -> Callable[[tuple[str, ...]], CachedMatcher]:
    """Return the factory of matchers with a common cache."""
    return lambda names: CachedMatcher(make_matcher(names), names, cache)


def _hash_images(frame_set: FrameSet) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for name in sorted(frame_set.images):
        digest.update(name.encode())
        digest.update(frame_set.images[name].tobytes())
    return digest.digest()
