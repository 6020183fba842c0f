"""A node's random numbers: a function of the graph's seed and the node's name, and handed over with it."""

import hashlib
import json

import numpy as np


def rng_of(seed: int, name: str) -> np.random.Generator:
    """Return the generator of a node; other names and seeds give independent streams."""
    words = np.frombuffer(hashlib.blake2b(name.encode(), digest_size=16).digest(), dtype="<u4")
    return np.random.default_rng([seed, *words.tolist()])


def rng_to_text(rng: np.random.Generator) -> str:
    """Return a generator's state as JSON text (its integers are longer than msgpack's)."""
    return json.dumps(rng.bit_generator.state, default=lambda value: value.tolist())


def rng_from_text(text: str) -> np.random.Generator:
    """Return a generator in a given state."""
    generator = np.random.Generator(np.random.PCG64())
    generator.bit_generator.state = json.loads(text)
    return generator
