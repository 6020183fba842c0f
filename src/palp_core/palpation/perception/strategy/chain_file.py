"""The file of a fitted strategy, which ``palp emg fit-policy`` writes and the Markov policy loads."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from palp_core.errors import PerceptionError, in_words
from palp_core.palpation.perception.strategy.markov import check_stochastic
from palp_core.palpation.perception.strategy.policies import MarkovPolicy, Reading
from palp_core.units import Float64Array
from palp_core.whole_file import read_whole, why_not, write_json

_LARGEST_BYTES = 16 << 20


class Chain(msgspec.Struct, frozen=True, kw_only=True):
    """A chain and what it was learnt from."""

    depth_m: float | None  # Nodule's depth in the trials it was learnt from; None: pooled over all trials
    matrix: list[list[float]]  # M[next, current], columns sum to 1
    counts: list[list[float]]  # Transitions behind it, by next and current level
    mean_level: float  # Mean co-contraction of the bursts, dimensionless: the mean of P_{S,1}
    sd_level: float  # Their standard deviation: sigma_S


class ChainFile(msgspec.Struct, frozen=True, kw_only=True):
    """Chains by depth, and their levels."""

    levels: list[float]  # Co-contraction of each level, dimensionless
    prior_count: float  # Pseudo-count of the Dirichlet prior of each entry
    chains: list[Chain]  # The pooled one first, then by rising depth where depths are known

    @property
    def pooled(self) -> Chain:
        """The chain of all trials together."""
        return next(chain for chain in self.chains if chain.depth_m is None)

    def matrices(self, depths_m: Sequence[float] = ()) -> Float64Array:
        """Return a matrix per depth, or where no depth is asked for or known the pooled one alone."""
        by_depth = {round(c.depth_m, 9): c for c in self.chains if c.depth_m is not None}
        if not depths_m or not by_depth:
            return np.array([self.pooled.matrix])
        missing = [d for d in depths_m if round(d, 9) not in by_depth]
        if missing:
            raise PerceptionError(
                f"no chain was learnt at {missing} m, only at {sorted(by_depth)} m; use mixture 'average'"
            )
        return np.array([by_depth[round(d, 9)].matrix for d in depths_m])


def read_chains(path: str | Path) -> ChainFile:
    """Return the chains of a file."""
    try:
        found = msgspec.json.decode(read_whole(path, _LARGEST_BYTES), type=ChainFile)
    except OSError as error:
        raise PerceptionError(f"{path}: cannot read the chain: {why_not(error, path)}") from error
    except msgspec.MsgspecError as error:
        raise PerceptionError(
            f"{path}: no chain: {in_words(error)}; `palp emg fit-policy FILE --out DIR` writes DIR/chain.json"
        ) from error
    if not any(chain.depth_m is None for chain in found.chains):
        raise PerceptionError(f"{path}: holds no pooled chain (depth_m null)")
    for chain in found.chains:
        try:
            matrix = check_stochastic(np.array(chain.matrix, dtype=np.float64))
        except ValueError as error:
            where = "pooled" if chain.depth_m is None else f"{chain.depth_m:g} m"
            raise PerceptionError(f"{path}: chain {where}: rows differ in length") from error
        except PerceptionError as error:
            raise PerceptionError(f"{path}: {error}") from error
        if len(matrix) != len(found.levels):
            raise PerceptionError(f"{path}: {len(matrix)} states for {len(found.levels)} levels")
    return found


def write_chains(chains: ChainFile, path: Path) -> None:
    """Write a file; it appears under its name only when complete."""
    write_json(path, chains)


def markov_policy(
    path: str | Path,
    *,
    reading: Reading = "column",
    mixture: Literal["average", "posterior"] = "average",
    depths_m: Sequence[float] = (),
) -> MarkovPolicy:
    """Return the policy that follows a learnt chain, with its own first mean and sigma_S."""
    found = read_chains(path)
    if mixture == "posterior" and (not depths_m or len(found.chains) < 2):
        raise PerceptionError(f"{path}: mixture 'posterior' needs depths, and a chain learnt at each")
    return MarkovPolicy(
        found.matrices(depths_m if mixture == "posterior" else ()),
        reading,
        mixture,
        levels=tuple(found.levels),
        mean_level=found.pooled.mean_level,
        sd_level=found.pooled.sd_level,
    )
