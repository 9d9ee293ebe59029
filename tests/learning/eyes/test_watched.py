"""Every lesson of the eyes shows how far it has come, also one that goes on after a stop."""

from contextlib import contextmanager

from semloc_jax.learning.eyes import teach
from semloc_jax.learning.eyes.teach import EyesConfig
from semloc_jax.learning.training import TrainingConfig
from semloc_jax.perception import load_class_table
from semloc_jax.perception.networks.eyes import Eyes, eyes_table
from semloc_jax.structs import ElementClass


def test_steps_of_a_lesson_are_told_under_its_name(tmp_path, monkeypatch):
    told = []

    @contextmanager
    def watched(name, num_steps):
        yield lambda step, loss: told.append((name, num_steps, step, loss))

    def train(network, loss, batch_of, config, checkpoint, on_step):
        on_step(7, 0.5)
        return network

    monkeypatch.setattr(teach, "train", train)
    monkeypatch.setattr(teach, "ImagePool", list)  # nothing is drawn from it here
    eyes = Eyes.new(eyes_table(load_class_table(teach.TABLE), frozenset({ElementClass.POLE})), 0)
    teach._trained(eyes, [], TrainingConfig(num_steps=9), EyesConfig(), tmp_path, "round_1", watched)
    assert told == [("round_1", 9, 7, 0.5)]
    assert (tmp_path / "round_1.weights").is_file()
