"""Run a localizer through a drive: features of the next frames while this one is localized (room: localization; host).

In: a Drive, masks, a Localizer. Out: one TrackResult for each frame, and how fast it went.
Two threads and one bounded queue. Offline the queue holds the reader back, and the results are those of a plain loop;
in real-time playback frames come when they came, and a frame for which there is no room is dropped.
"""

import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from semloc_jax.alignment.pose_prior import PriorSource
from semloc_jax.cameras import Rig
from semloc_jax.datasets import Drive, Frame
from semloc_jax.fusion.measurements import GnssMeasurement
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.localization.beginning import rehearse
from semloc_jax.localization.checkpoint import Checkpoint
from semloc_jax.localization.localizer import Localizer
from semloc_jax.localization.track_state import FrameFeatures, TrackResult, TrackStatus
from semloc_jax.residuals.pose_terms import TermSource
from semloc_jax.runtime.allocator import return_large_blocks

_QUEUE = 3
"""Frames that may wait: more would only be older."""
_WARM_UP = 3
"""Frames after which everything is compiled: a search, a search along the road, an alignment."""


@dataclass(frozen=True)
class PipelineConfig:
    """How a drive is played. All values are ours."""

    realtime: bool = False
    """Frames come at the pace of the drive; those that come too fast are dropped."""
    threads: bool = True
    """Read and prepare the next frames while this one is localized."""
    gnss_after_init: bool = True
    """Whether satellite fixes are used once the vehicle was tracked."""


@dataclass
class Timing:
    """How fast a run was."""

    wall_s: float = 0.0
    """Time spent after the first frames, which compile."""
    driven_s: float = 0.0
    num_dropped: int = 0
    feature_ms: list[float] = field(default_factory=list)
    localize_ms: list[float] = field(default_factory=list)

    @property
    def num_frames(self) -> int:
        """Frames localized so far."""
        return len(self.localize_ms)

    def stages_ms(self) -> dict[str, float]:
        """Median, mean and 99th percentile of both stages, without the frames that compile [ms]."""
        found = {}
        for name, times in (("features", self.feature_ms), ("localize", self.localize_ms)):
            warm = np.array(times[_WARM_UP:] or times or [np.nan])
            found |= {f"{name}.mean": warm.mean(), f"{name}.median": np.median(warm)}
            found |= {f"{name}.p99": np.percentile(warm, 99.0)}
        return {key: float(value) for key, value in found.items()}

    @property
    def realtime_factor(self) -> float:
        """Time of the drive over time spent; above 1 keeps up."""
        return self.driven_s / self.wall_s if self.wall_s > 0 else float("nan")


class Pipeline:
    """A drive, its masks and a localizer."""

    def __init__(
        self,
        drive: Drive,
        source: MaskSource,
        localizer: Localizer,
        config: PipelineConfig | None = None,
        guess: PriorSource | None = None,
        terms: TermSource | None = None,
    ) -> None:
        """Put the parts together; nothing runs yet.

        Args:
            drive: Frames and sensors.
            source: Masks.
            localizer: Follows the vehicle.
            config: None for the defaults.
            guess: First guess of the pose of a frame, used where there is no pose and fixes do not give one.
            terms: What else was measured at a frame; see `pose_term`.
        """
        self.drive, self.source, self.localizer, self.guess, self.terms = drive, source, localizer, guess, terms
        self.config, self.timing = config or PipelineConfig(), Timing()
        self._rigs: tuple[Rig, Rig] | None = None

    def fixes(self, after_s: float, to_s: float) -> tuple[GnssMeasurement, ...]:
        """Satellite fixes of a stretch of time, its end included."""
        track = self.drive.gnss
        if track is None:
            return ()
        rows = np.flatnonzero((track.time_s > after_s) & (track.time_s <= to_s))
        return tuple(GnssMeasurement(float(track.time_s[k]), track.p_enu[k], track.sigma_m[k]) for k in rows)

    def features(self, frame: Frame, before_s: float) -> FrameFeatures:
        """Masks and cost maps of a frame, with the fixes since the frame before it."""
        started = time.perf_counter()
        rig = self._rig_of(frame)
        fixes = self.fixes(before_s, frame.time_s)
        guess = self.guess(frame) if self.guess is not None and np.isfinite(frame.time_s) else None
        terms = () if self.terms is None else self.terms(frame)
        features = self.localizer.features(frame, self.source.masks(frame), rig, fixes, guess, terms)
        self.timing.feature_ms.append(1e3 * (time.perf_counter() - started))
        return features

    def _rig_of(self, frame: Frame) -> Rig:
        """The rig of the masks: the same object as long as the frames have the same one, so that what is made of it is
        made once."""
        if self._rigs is None or self._rigs[0] is not frame.rig:
            self._rigs = frame.rig, self.source.seen_by(frame.rig.select(self.source.cameras))
        return self._rigs[1]

    def run(
        self,
        frames: Sequence[Frame],
        start: Checkpoint | None = None,
        on_frame: Callable[[Checkpoint, TrackResult], None] | None = None,
    ) -> Iterator[TrackResult]:
        """One TrackResult after another.

        Args:
            frames: In time order; one that is not costs itself only, see `Localizer.step`.
            start: Where an earlier run stood; None begins with the first frame.
            on_frame: Called after each frame with the checkpoint and the result.
        """
        return_large_blocks()
        rehearse(self.localizer.fusion)
        at = start or Checkpoint(self.localizer.start(), 0, False)
        state, is_initialised = at.state, at.is_initialised
        begun_s, first_s = time.perf_counter(), 0.0
        for index, features in self._fed(frames, at.next_frame):
            if is_initialised and not self.config.gnss_after_init:
                features = features._replace(fixes=())
            before = time.perf_counter()
            state, result = self.localizer.step(state, features)
            now = time.perf_counter()
            self.timing.localize_ms.append(1e3 * (now - before))
            is_initialised = is_initialised or result.status == TrackStatus.TRACKING
            if self.timing.num_frames <= _WARM_UP:
                begun_s, first_s = now, features.time_s
            self.timing.wall_s, self.timing.driven_s = now - begun_s, features.time_s - first_s
            if on_frame is not None:
                on_frame(Checkpoint(state, index + 1, is_initialised), result)
            yield result

    def _fed(self, frames: Sequence[Frame], first: int) -> Iterator[tuple[int, FrameFeatures]]:
        """Place and features of each frame, in order."""
        # A frame that comes late or without a time does not bring fixes back that were there before.
        before_s = np.fmax.accumulate([-np.inf, *(frame.time_s for frame in frames)]).tolist()
        if self.config.realtime:
            self._warm_up(frames[first : first + _WARM_UP], before_s[first])
        if not (self.config.threads or self.config.realtime):
            for index in range(first, len(frames)):
                yield index, self.features(frames[index], before_s[index])
            return
        waiting: queue.Queue = queue.Queue(_QUEUE)
        stop = threading.Event()
        worker = threading.Thread(target=self._feed, args=(frames, before_s, first, waiting, stop), daemon=True)
        worker.start()
        try:
            while (item := waiting.get()) is not None:
                if isinstance(item, BaseException):
                    raise item
                yield item
        finally:
            stop.set()
            while worker.is_alive():
                _emptied(waiting)
                worker.join(0.01)

    def _feed(
        self,
        frames: Sequence[Frame],
        before_s: Sequence[float],
        first: int,
        waiting: queue.Queue,
        stop: threading.Event,
    ) -> None:
        """Fill the queue with features, or with the error that ended it; None comes last."""
        last: BaseException | None = None
        taken_s = before_s[first]
        begun_s = time.perf_counter()
        try:
            for index in range(first, len(frames)):
                if self.config.realtime:
                    due_s = begun_s + frames[index].time_s - frames[first].time_s
                    time.sleep(max(due_s - time.perf_counter(), 0.0))
                    if waiting.full():
                        self.timing.num_dropped += 1
                        continue
                waiting.put((index, self.features(frames[index], taken_s)))
                taken_s = before_s[index + 1]
                if stop.is_set():
                    return
        except BaseException as error:
            last = error  # raised again in the thread that reads the queue
        waiting.put(last)

    def _warm_up(self, frames: Sequence[Frame], before_s: float) -> None:
        """Compile what a drive needs, on its first frames and a state that is thrown away."""
        state = self.localizer.start()
        for frame in frames:
            state, _ = self.localizer.step(state, self.features(frame, before_s))
            before_s = frame.time_s
        self.timing.feature_ms.clear()


def _emptied(waiting: queue.Queue) -> None:
    while True:
        try:
            waiting.get_nowait()
        except queue.Empty:
            return
