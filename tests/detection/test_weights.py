"""Public checkpoints of YOLOX: made here as Megvii's code makes them, because theirs are not ours to ship."""

import numpy as np
import pytest

from skysweep.detection.coco import COCO_80
from skysweep.detection.training.train import _network
from skysweep.detection.training.weights import Family, family_of, load_weights
from skysweep.errors import UserError

torch = pytest.importorskip("torch")
NANO, TINY, OWN = Family(0.33, 0.25, True), Family(0.33, 0.375, False), Family(0.33, 0.25, False)
CLASSES = ("boat", "buoy", "person")


def trained(family, n_classes=80):
    """A network whose weights and statistics are not those that a new one has."""
    torch.manual_seed(3)
    network = _network(n_classes, family)
    for value in network.state_dict().values():
        if value.is_floating_point():
            value.add_(torch.rand_like(value) * 0.1)
    return network.eval()


def answer(network, picture):
    """Boxes, objectness and the classes person and boat."""
    network.eval()
    network.head.decode_in_inference = False
    with torch.no_grad():
        return network(picture)[0]


@pytest.mark.parametrize("family", [NANO, TINY, OWN])
@pytest.mark.parametrize("suffix", [".pth", ".onnx"])
def test_public_checkpoints_start_the_same_network(family, suffix, tmp_path):
    theirs, path = trained(family), tmp_path / f"yolox{suffix}"
    if suffix == ".pth":
        torch.save({"model": theirs.state_dict(), "start_epoch": 300}, path)
    else:
        theirs.head.decode_in_inference = False
        example = torch.zeros(1, 3, 416, 416)
        torch.onnx.export(theirs, (example,), str(path), opset_version=11, dynamo=False)
    assert family_of(path) == family
    ours = _network(len(CLASSES), family)
    load_weights(ours, path, CLASSES)
    picture = torch.rand(1, 3, 64, 96) * 255
    before, after = answer(theirs, picture), answer(ours, picture)
    np.testing.assert_allclose(after[:, :5], before[:, :5], rtol=2e-3, atol=2e-3)
    for k, name in ((0, "boat"), (2, "person")):
        np.testing.assert_allclose(after[:, 5 + k], before[:, 5 + COCO_80.index(name)], rtol=2e-3, atol=2e-3)


@pytest.mark.parametrize("name", ["a.onnx", "a.pth"])
def test_other_files_are_one_sentence(name, tmp_path):
    path = tmp_path / name
    path.write_bytes(b"no model")
    with pytest.raises(UserError, match="neither a model that 'skysweep train' wrote nor a YOLOX checkpoint"):
        family_of(path)


def test_a_large_yolox_is_refused(tmp_path):
    path = tmp_path / "yolox_m.pth"
    state = {"backbone.backbone.stem.conv.conv.weight": torch.zeros(48, 12, 3, 3)}
    torch.save({"model": state | {"head.cls_preds.0.weight": torch.zeros(80, 192, 1, 1)}}, path)
    with pytest.raises(
        UserError, match="is no YOLOX of a size that can be trained here; give a nano, tiny or s"
    ):
        family_of(path)


def test_a_pickle_that_would_run_code_is_refused(tmp_path):
    path = tmp_path / "evil.pth"

    class Evil:
        def __reduce__(self):
            return (__import__("os").system, ("touch " + str(tmp_path / "ran"),))

    torch.save({"model": Evil()}, path)
    with pytest.raises(UserError):
        family_of(path)
    assert not (tmp_path / "ran").exists()
