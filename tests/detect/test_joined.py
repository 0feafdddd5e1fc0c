"""Parts of an object that touch are joined."""

import numpy as np

from zeroshop_steps.detect.joined import TOUCH_PX, join_touching


def block(columns: slice) -> np.ndarray:
    mask = np.zeros((30, 60), bool)
    mask[10:20, columns] = True
    return mask


def test_parts_that_touch_are_joined_and_others_are_not() -> None:
    left, beside, far = block(slice(5, 20)), block(slice(20 + TOUCH_PX - 1, 30)), block(slice(45, 55))
    (joined,) = join_touching([left, far, beside])
    assert np.array_equal(joined, left | beside)
    assert join_touching([left]) == [] and join_touching([]) == []


def test_one_part_found_twice_is_no_second_part() -> None:
    assert join_touching([block(slice(5, 20)), block(slice(6, 22))]) == []
    assert len(join_touching([block(slice(5, 20)), block(slice(18, 40))])) == 1
