"""What is made of an object is made once for it, and never taken for that of another one."""

from semloc_jax.runtime.memory import once_for_each


def test_a_result_is_made_once_for_each_object_and_argument():
    made = []

    @once_for_each
    def size_of(thing, factor):
        made.append(factor)
        return factor * len(thing)

    one, equal = [1, 2], [1, 2]
    assert [size_of(one, 3), size_of(one, 3), size_of(one, 4), size_of(equal, 3)] == [6, 6, 8, 6]
    assert made == [3, 4, 3]  # an equal object is another one
    for k in range(100):  # each lives no longer than its turn, so that places in memory are used again
        assert size_of([0] * k, 1) == k
