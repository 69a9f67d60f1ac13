"""Seeds for everything random in a recipe; each depends only on what it belongs to."""

import hashlib

import numpy as np


def derive_seed(*parts: int | str) -> int:
    """Return a 32-bit seed that depends on all parts and nothing else: no order of rendering, process or machine."""
    text = "/".join(map(str, parts)).encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=4).digest(), "little")


def derive_generator(*parts: int | str) -> np.random.Generator:
    """Return a NumPy generator that depends on all parts and nothing else, seeded with 128 bits."""
    text = "/".join(map(str, parts)).encode()
    return np.random.default_rng(int.from_bytes(hashlib.blake2b(text, digest_size=16).digest(), "little"))
