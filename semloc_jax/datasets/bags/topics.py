"""Which topic is which camera (room: datasets; host).

In: names of image and CameraInfo topics. Out: for each camera its image topic, its CameraInfo and its masks.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

_TRANSPORTS = ("compressed", "raw", "image_raw_compressed")
_IMAGE_WORDS = ("image", "img", "rgb", "color", "colour", "mono", "rect", "raw")
_MASK_WORDS = ("sem", "seg", "mask", "label")
_LEFT_OUT = ("depth", "disparity", "theora", "confidence", "infra")


@dataclass(frozen=True)
class CameraTopics:
    """Topics of one camera.

    Args:
        image: topic of its images, None where only masks were recorded.
        info: topic of its CameraInfo.
        masks: topic of each kind of masks.
    """

    image: str | None
    info: str | None
    masks: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_rectified(self) -> bool:
        """Whether the images are free of distortion: the P matrix of the CameraInfo is theirs, not K and D."""
        return self.image is not None and "rect" in base_topic(self.image).rsplit("/", 1)[-1]


def base_topic(topic: str) -> str:
    """The topic without the name of its transport: /front/image_raw of /front/image_raw/compressed."""
    head, _, last = topic.rpartition("/")
    return head if last in _TRANSPORTS and head else topic


def camera_topics(images: Mapping[str, int], infos: Iterable[str]) -> dict[str, CameraTopics]:
    """Topics of each camera by its name: the part of the namespace in which the cameras differ.

    Args:
        images: number of messages of each image topic, raw or compressed.
        infos: topics of CameraInfo.
    """
    info_of = {topic.rpartition("/")[0]: topic for topic in infos}
    pictures: dict[str, str] = {}
    masks: dict[str, dict[str, str]] = {}
    # Most messages first; a raw topic before its compressed copy.
    for topic in sorted(images, key=lambda t: (-images[t], t != base_topic(t), t)):
        namespace, _, last = base_topic(topic).rpartition("/")
        if any(word in topic.lower() for word in _LEFT_OUT):
            continue
        if any(word in last.lower() for word in _MASK_WORDS):
            masks.setdefault(namespace, {}).setdefault(last, topic)
        elif any(word in last.lower() for word in _IMAGE_WORDS):
            pictures.setdefault(namespace, topic)
        else:  # /front_camera instead of /front_camera/image
            pictures.setdefault(base_topic(topic), topic)
    namespaces = sorted({*pictures, *masks})
    names = _short_names(namespaces)
    return {
        names[space]: CameraTopics(pictures.get(space), _info_of(space, info_of), masks.get(space, {}))
        for space in namespaces
    }


def _info_of(namespace: str, info_of: Mapping[str, str]) -> str | None:
    while namespace not in info_of and "/" in namespace.strip("/"):
        namespace = namespace.rpartition("/")[0]
    return info_of.get(namespace)


def _short_names(namespaces: list[str]) -> dict[str, str]:
    """The words in which the namespaces differ, joined; the last word where there is only one namespace."""
    words = {space: [word for word in space.split("/") if word] or ["camera"] for space in namespaces}
    shared = set.intersection(*(set(parts) for parts in words.values())) if len(words) > 1 else set()
    own = {space: [word for word in parts if word not in shared] or parts for space, parts in words.items()}
    short = {space: parts[-1] for space, parts in own.items()}
    return short if len(set(short.values())) == len(short) else {space: "_".join(p) for space, p in own.items()}
