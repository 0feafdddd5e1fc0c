"""The memory that VGGT will take is foreseen: what does not fit is refused, and a card sees as many images at a time as fit."""

from types import SimpleNamespace

import pytest

from zeroshop_steps import methods
from zeroshop_steps.networks.vggt.settings import VggtSettings
from zeroshop_steps.networks.weights import look_up_weights
from zeroshop_steps.register.vggt import memory
from zeroshop_steps.register.vggt.memory import CHUNKS, check_fits, load_network, predict_peak_bytes
from zeroshop_steps.register.vggt.options import VggtOptions
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import is_result


def test_the_memory_is_predicted_and_too_much_is_refused():
    def predict(count: int) -> int:
        return predict_peak_bytes(VggtSettings(), 5_000_000_000, count, (518, 392), 1024, 1)

    assert predict(20) < predict(300)
    with pytest.raises(
        StepError, match=r"VGGT needs about .* GB for 300 images of 518 x 392 px, the cpu has 24.0 GB free; \d+ images would fit"
    ) as caught:
        check_fits("VGGT", predict, 300, (518, 392), 24_000_000_000, "the cpu")
    fits = int(str(caught.value).split("; ")[1].split()[0])
    check_fits("VGGT", predict, fits, (518, 392), 24_000_000_000, "the cpu")
    assert not is_result(caught.value)
    with pytest.raises(StepError, match="not even 3 images"):
        check_fits("VGGT", predict, 300, (518, 392), 4_000_000_000, "the cpu")


def test_the_rule_asks_for_the_memory_of_twenty_images():
    file = look_up_weights(methods.REGISTRATIONS["vggt"].weights[0])
    needed = predict_peak_bytes(VggtSettings(), file.size_bytes, 20, (518, 392), VggtOptions().tracked_points, CHUNKS["cuda"][0])
    assert needed < 1e6 * methods.REGISTRATIONS["vggt"].mem_mb < 1.5 * needed


@pytest.mark.parametrize(
    ("free_gb", "precision", "chunk"), [(40, "bfloat16", 8), (8, "bfloat16", 4), (10, "float32", 4), (7, "bfloat16", 0)]
)
def test_a_card_takes_as_many_images_at_a_time_as_fit(monkeypatch, free_gb, precision, chunk):
    """20 images by the thesis's quarter precision: a card of 12 GB has 11 GB free, of which these leave some."""
    monkeypatch.setattr(memory, "choose_device", lambda name: "cuda")
    monkeypatch.setattr(memory, "measure_free_bytes", lambda device: free_gb * 10**9)

    def predict(count, chunk, half):
        return predict_peak_bytes(
            VggtSettings(), look_up_weights("VGGT-1B/model.safetensors").size_bytes, count, (518, 392), 1024, chunk, half
        )

    args = SimpleNamespace(device="auto", precision=precision, threads=1)
    image_set = SimpleNamespace(images=list(range(20)))

    def build(device, precision, chunk):
        return SimpleNamespace(precision=precision)

    if chunk:
        _, known = load_network("VGGT", build, predict, image_set, (518, 392), args)
        assert known["images_at_a_time"] == chunk and known["precision"] == precision and known["predicted_peak_gb"] <= free_gb
    else:
        with pytest.raises(StepError, match="VGGT needs about 7.6 GB for 20 images of 518 x 392 px, the cuda has 7.0 GB free"):
            load_network("VGGT", build, predict, image_set, (518, 392), args)
