"""How the networks of the usual exporters take images and give classes (room: perception; host).

In: the name of a recipe. Out: NetworkPreset, to which a model is given.
A recipe says what an exporter does to every network of its kind; sizes that the file states are taken from the file.
"""

import difflib

from semloc_jax.errors import SemlocError
from semloc_jax.perception.network import NetworkPreset

_HALF = (0.5, 0.5, 0.5)
_ZERO, _ONE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)

RECIPES = {
    # optimum-cli export onnx: any size, scores at a quarter of it. Its image processor stretches images.
    "segformer-cityscapes": NetworkPreset(
        class_table="cityscapes", width_px=1024, height_px=512, letterbox=False, output="logits"
    ),
    "segformer-mapillary": NetworkPreset(
        class_table="mapillary", width_px=1024, height_px=512, letterbox=False, output="logits"
    ),
    # mmdeploy, configs/mmseg: any size or one, the best class chosen inside, [b 1 h w].
    "mmseg-cityscapes": NetworkPreset(class_table="cityscapes", letterbox=False, output="output"),
    "mmseg-mapillary": NetworkPreset(class_table="mapillary", letterbox=False, output="output"),
    # PaddleSeg export.py and paddle2onnx: any size or one, the best class chosen inside, [b h w]; outputs of any name.
    "paddleseg-cityscapes": NetworkPreset(class_table="cityscapes", letterbox=False, mean=_HALF, std=_HALF),
    "paddleseg-mapillary": NetworkPreset(class_table="mapillary", letterbox=False, mean=_HALF, std=_HALF),
    # torchvision: scores at the size of the image, and those of an auxiliary head that is for training alone.
    "torchvision-cityscapes": NetworkPreset(class_table="cityscapes", letterbox=False, output="out"),
    # tf2onnx of a Keras network: channels last, bytes to -1 ... 1.
    "keras-cityscapes": NetworkPreset(
        class_table="cityscapes", letterbox=False, channels_last=True, mean=_HALF, std=_HALF
    ),
    # https://github.com/chequanghuy/TwinLiteNet: 640x360, 0 ... 1; drivable area, then lane lines.
    "twinlite": NetworkPreset(
        class_table="twinlite", width_px=640, height_px=360, letterbox=False, mean=_ZERO, std=_ONE, bits=(2, 1)
    ),
    # https://github.com/hustvl/YOLOP: 640x640, letterbox; boxes first, then drivable area, then lane lines.
    "yolop": NetworkPreset(
        class_table="twinlite",
        width_px=640,
        height_px=640,
        output="drive_area_seg,lane_line_seg",
        bits=(2, 1),
    ),
}
"""Recipes by name."""


def recipe(name: str) -> NetworkPreset:
    """The recipe of that name.

    Raises:
        SemlocError: there is none.
    """
    if name not in RECIPES:
        close = difflib.get_close_matches(name, RECIPES, n=1)
        hint = f"; did you mean '{close[0]}'?" if close else ""
        raise SemlocError(f"preset '{name}': neither a YAML file nor a recipe{hint}; recipes: {', '.join(RECIPES)}")
    return RECIPES[name]
