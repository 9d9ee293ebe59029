"""Rounds of the eyes: every lesson shows how far it has come, and one in vain is taken back."""

from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import pytest

from semloc_jax.learning.eyes import teach
from semloc_jax.learning.eyes.judge import RoundScore
from semloc_jax.learning.eyes.lessons import Lesson
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


def test_a_round_in_vain_is_taken_back_and_tried_more_gently(tmp_path, monkeypatch):
    """Round 1 is worse than what there was, round 2 better, round 3 worse: what each one begins with, and its rate."""
    first = Eyes.new(eyes_table(load_class_table(teach.TABLE), frozenset({ElementClass.POLE})), 0)
    begun, labels = [], []

    def trained(eyes, images, training, config, folder, name, watched):
        begun.append((eyes.card.get("name", "first"), training.seed, training.rate))
        return replace(eyes, card={"name": name})

    def labelled(lessons, seen_by, student, *rest):
        labels.append(student.card.get("name", "first"))
        return teach.Labelled([], [], 0)

    along = {None: 0.2, "round_1": 0.3, "round_2": 0.1, "round_3": 0.4}

    def score(held_out, eyes, config):
        name = None if eyes is None else eyes.card["name"]
        return RoundScore(9, 9, 9, 0, (0.01, along[name], 0.1), (0.1, 0.3, 0.3), (0.7, 0.9, 1.0))

    for name, made in (("_trained", trained), ("labelled_by_map", labelled), ("_score", score)):
        monkeypatch.setattr(teach, name, made)
    lesson = object.__new__(Lesson)
    object.__setattr__(lesson, "map", SimpleNamespace(labels=frozenset({ElementClass.POLE})))  # all that is asked for
    config = EyesConfig(rounds=3, training=TrainingConfig(rate=1e-3, seed=5))
    rounds = teach.taught([lesson], lesson, config, tmp_path, begin=first)
    assert [(name, seed) for name, seed, _ in begun] == [("first", 5), ("first", 6), ("round_2", 7)]
    assert [rate / 1e-3 for *_, rate in begun] == pytest.approx([0.1, 0.03, 0.1])
    assert labels == ["first", "round_2"] and teach.best_round(rounds) == 2
    begun.clear()
    monkeypatch.setattr(teach.Eyes, "new", lambda *rest: first)
    teach.taught([lesson], lesson, config, tmp_path)
    assert [name for name, *_ in begun] == ["first", "round_1", "round_2"], "new eyes go on from a round in vain"
