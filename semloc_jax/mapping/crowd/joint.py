"""Where everything is and how far each drive lies off, in one solve (room: mapping; host).

In: CrowdWorld, drives with their corrections. Out: the same, moved: sparse least squares, robust by iterated weights.
Things are unknown in two directions, lines at each station to the side, drives by their correction. The common shift of
all drives is held by what satellite fixes know of each: nothing else can, so it shrinks with the root of their number.
"""

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array, csr_array, vstack
from scipy.sparse.linalg import splu

from semloc_jax.geometry.plane import SIGMA_OF_MAD
from semloc_jax.mapping.crowd.correction import SCALE, Correction
from semloc_jax.mapping.crowd.seen import Seen
from semloc_jax.mapping.crowd.world import CrowdWorld

_SMOOTH_M = 0.02
"""By how much a line bends within a metre that is not its curvature."""
_LOSS_WIDTH = 2.5
_LEAST_FACTOR, _MOST_FACTOR = np.array([0.2, 0.2, 1.0]), 4.0
"""Neighbouring stations share their error: that they agree does not make them surer."""
_TOGETHER = np.array([1e-3, 1e-3, 1e-6, 1e-6])
"""How closely the mean shift [m], turn [rad] and scale of all drives are held at zero."""
_PLACED_SIGMAS = 2.0
"""A drive that is not trusted counts for the mean place if it is no farther from the others; ours."""
_ROUNDS = 4
_FREE = 0.01


class JointSolve:
    """The equations of a world and its drives; `world_moves` False holds the world and places the drives in it."""

    def __init__(
        self,
        world: CrowdWorld,
        drives: list[Correction],
        seen: list[Seen],
        weights: list[float],
        world_moves: bool = True,
    ):
        self.world, self.drives, self.seen, self.weights = world, drives, seen, weights
        self.moves = world_moves
        self._first_station = np.cumsum([0, *(len(line.reference) for line in world.lines)])
        num_world = 2 * len(world.kind) + int(self._first_station[-1]) if world_moves else 0
        self._first_drive = num_world + np.cumsum([0, *(drive.size for drive in drives)])

    def run(self) -> None:
        """Solves, with weights anew in each round, and moves world and drives."""
        parts = [self._rows_of(k) for k in range(len(self.drives))]
        priors = self._priors()
        for round_ in range(_ROUNDS):
            rows, targets = [priors[0]], [priors[1]]
            for A, b, group in parts:
                factor = self.seen[group[0]].factor[group[1]] if len(b) else np.ones(0)
                weight = 1.0 / factor
                if round_:
                    r = (b - A @ self._value) / factor
                    weight = weight / (1.0 + (r / _LOSS_WIDTH) ** 2)
                weight = weight * np.sqrt(self.weights[group[0]])
                rows.append(csr_array(A.multiply(weight[:, None])))
                targets.append(b * weight)
            A, b = vstack(rows).tocsc(), np.concatenate(targets)
            normal = (A.T @ A).tocsc()
            self._normal = splu(normal, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0)
            self._value = self._normal.solve(A.T @ b)
            if self.moves:
                for A_own, b_own, group in parts:
                    self._judge(b_own - A_own @ self._value, group)
        self._move()

    def covariance(self, rows: list[tuple[int, np.ndarray]]) -> Float[np.ndarray, "n n"]:
        """Joint covariance of what rows of unknowns of drives give, as the last round knows it.

        Args:
            rows: `[m p]` of which drive, and by its unknowns; all stacked in this order.
        """
        wide = np.zeros((sum(len(own) for _, own in rows), int(self._first_drive[-1])))
        first = 0
        for k, own in rows:
            wide[first : first + len(own), self._first_drive[k] : self._first_drive[k + 1]] = own
            first += len(own)
        return wide @ self._normal.solve(np.ascontiguousarray(wide.T))

    def _rows_of(self, k: int) -> tuple[csr_array, np.ndarray, tuple[int, np.ndarray]]:
        """Whitened rows of one drive: world minus where the drive sees it is 0; which factor each row has."""
        drive, seen, world = self.drives[k], self.seen[k], self.world
        things = drive.sights.things
        i, j = seen.pairs[:, 0], seen.pairs[:, 1]
        ahead = world.along[j]
        axes = np.stack([ahead, np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)], axis=1)
        sigma = things.sigma_m[i].copy()
        if not drive.sights.is_base:
            sigma[~things.has_ends[i], 0] = 10.0  # a part tells nothing along
        shift = np.einsum("nak,nkp->nap", axes, drive.thing_rows[i]) / sigma[:, :, None]
        start = np.einsum("nak,nk->na", axes, world.centre[j] if not self.moves else np.zeros((len(j), 2)))
        own = np.einsum("nak,nk->na", axes, things.centre[i])
        n = len(i)
        row = np.arange(2 * n).reshape(n, 2)
        data = [(row, axes / sigma[:, :, None], 2 * j)] if self.moves else []
        left = np.array([world.lines[a].left[s] for a, s in zip(seen.line, seen.station, strict=True)]).reshape(-1, 2)
        near = np.array([world.lines[a].reference[s] for a, s in zip(seen.line, seen.station, strict=True)])
        near = near.reshape(-1, 2)
        aside = np.einsum("nk,nkp->np", left, drive.rows(seen.places[:, :2])) / seen.sigma_m[:, None]
        b_line = ((seen.places[:, :2] - near) * left).sum(axis=1)
        if not self.moves:
            offset = [world.lines[a].offset_m[s] for a, s in zip(seen.line, seen.station, strict=True)]
            b_line = b_line - np.array(offset).reshape(-1)
        b = np.concatenate([((own - start) / sigma).ravel(), b_line / seen.sigma_m])
        m, size = len(b_line), int(self._first_drive[-1])
        entries = []
        for at, values, column in data:
            for axis in (0, 1):
                entries.append((at.ravel(), values[:, :, axis].ravel(), np.repeat(column + axis, 2)))
        if self.moves and m:
            column = 2 * len(world.kind) + self._first_station[seen.line] + seen.station
            entries.append((2 * n + np.arange(m), 1.0 / seen.sigma_m, column))
        dense = np.vstack([shift.reshape(2 * n, drive.size), aside]) if n or m else np.zeros((0, drive.size))
        r, c = np.nonzero(dense)
        entries.append((r, -dense[r, c], self._first_drive[k] + c))
        rows, values, columns = (np.concatenate(parts) for parts in zip(*entries, strict=True))
        A = csr_array(coo_array((values, (rows, columns)), shape=(2 * n + m, size)))
        return A, b, (k, np.concatenate([np.tile([0, 1], n), np.full(m, 2)]).astype(int))

    def _priors(self) -> tuple[csr_array, np.ndarray]:
        """What is known without any sight: of the drives, and that lines are smooth."""
        size = int(self._first_drive[-1])
        rows, targets = [], []
        for k, drive in enumerate(self.drives):
            A, b = drive.known()
            A = A.tocoo()
            rows.append(csr_array(coo_array((A.data, (A.row, A.col + self._first_drive[k])), (A.shape[0], size))))
            targets.append(b)
        if self.moves:
            together, target = self._together(size)
            rows.append(together)
            targets.append(target)
            # What no drive sees any more stays about where it is.
            now = np.concatenate([self.world.centre.ravel(), *(line.offset_m for line in self.world.lines)])
            things, places = self._num_drives()
            lost = np.flatnonzero(np.concatenate([np.repeat(things, 2), places]) == 0)
            free = coo_array((np.full(len(lost), _FREE), (np.arange(len(lost)), lost)), (len(lost), size))
            rows.append(csr_array(free))
            targets.append(_FREE * now[lost])
            for k, line in enumerate(self.world.lines):
                smooth = self._smooth(line.rough, line.left, 2 * len(self.world.kind) + int(self._first_station[k]))
                rows.append(smooth[0])
                targets.append(smooth[1])
        return csr_array(vstack(rows)), np.concatenate(targets)

    def _together(self, size: int) -> tuple[csr_array, np.ndarray]:
        """On the mean, drives are neither shifted nor turned, and as large as their wheels and fixes say.

        That is what is known of each alone, but the many sights would outweigh it: in a world that is a little smaller,
        all their errors are a little smaller too. Masks make all maps too small alike, wheels and fixes do not. A
        surveyed map knows better than all of them.
        """
        if any(drive.is_held for drive in self.drives):
            return csr_array((0, size)), np.zeros(0)
        own = self._placed_as_others()
        row, which = np.repeat(np.arange(4), len(own)), np.tile(self._first_drive[own], 4)
        placed = np.array([self.drives[k].sights.sigma_place_m ** -2.0 for k in own])
        many = np.array([float(self.drives[k].sights.num_drives) for k in own])
        shares = [w / max(w.sum(), 1e-300) for w in (placed, placed, many, many)]
        values = (np.array(shares) / _TOGETHER[:, None]).ravel()
        target = np.zeros(4)
        target[SCALE] = shares[SCALE] @ [self.drives[k].sights.scale - 1.0 for k in own] / _TOGETHER[SCALE]
        return csr_array(coo_array((values, (row, which + row)), (4, size))), target

    def _placed_as_others(self) -> list[int]:
        """Drives that count for the mean: a camera that is turned says nothing against fixes and wheels."""
        trusted = [k for k, weight in enumerate(self.weights) if weight >= 1.0]
        middle = np.median([self.drives[k].value[:2] for k in trusted], axis=0)
        near = [
            np.linalg.norm(drive.value[:2] - middle) < _PLACED_SIGMAS * drive.sights.sigma_place_m
            for drive in self.drives
        ]
        return [k for k, is_near in enumerate(near) if is_near or k in trusted]

    def _smooth(self, rough: np.ndarray, left: np.ndarray, first: int) -> tuple[csr_array, np.ndarray]:
        """The line runs as smoothly as its reference without its wobble does: curves of the road cost nothing."""
        m = max(len(rough) - 2, 0)
        row = np.arange(m)
        bend = ((rough[:-2] - 2.0 * rough[1:-1] + rough[2:]) * left[1:-1]).sum(axis=1) if m else np.zeros(0)
        values = np.concatenate([np.ones(m), np.full(m, -2.0), np.ones(m)]) / _SMOOTH_M
        columns = np.concatenate([first + row, first + row + 1, first + row + 2])
        size = int(self._first_drive[-1])
        return csr_array(coo_array((values, (np.tile(row, 3), columns)), (m, size))), -bend / _SMOOTH_M

    def _judge(self, r: np.ndarray, group: tuple[int, np.ndarray]) -> None:
        """How much larger the errors of a drive are than it says; what it alone saw does not say."""
        num = self._num_seen(group[0])
        grown = np.sqrt(num / np.maximum(num - 1.0, 0.5))
        for which in range(3):
            own = np.abs(r * grown)[(group[1] == which) & (num > 1)]
            if len(own) >= 4:
                found = SIGMA_OF_MAD * float(np.median(own))
                self.seen[group[0]].factor[which] = np.clip(found, _LEAST_FACTOR[which], _MOST_FACTOR)

    def _num_drives(self) -> tuple[np.ndarray, np.ndarray]:
        """How many drives saw each thing and each station."""
        things, first = np.zeros(len(self.world.kind)), self._first_station
        places = np.zeros(int(first[-1]))
        for seen in self.seen:
            things[seen.pairs[:, 1]] += 1
            places[first[seen.line] + seen.station] += 1
        return things, places

    def _num_seen(self, k: int) -> np.ndarray:
        """How many drives saw what each row of a drive is about."""
        things, places = self._num_drives()
        own, first = self.seen[k], self._first_station
        return np.concatenate([np.repeat(things[own.pairs[:, 1]], 2), places[first[own.line] + own.station]])

    def _move(self) -> None:
        if self.moves:
            n = 2 * len(self.world.kind)
            self.world.centre = self._value[:n].reshape(-1, 2)
            for k, line in enumerate(self.world.lines):
                line.offset_m = self._value[n + self._first_station[k] : n + self._first_station[k + 1]]
        for k, drive in enumerate(self.drives):
            drive.value = self._value[self._first_drive[k] : self._first_drive[k + 1]]
