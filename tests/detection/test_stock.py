import numpy as np
import onnxruntime as ort
import pytest

from skysweep.detection.training.stock import convert_darknet, parse_configuration
from skysweep.errors import UserError

CONFIGURATION = """
[net]
width=32  # ignored
[convolutional]
batch_normalize=1
filters=2
size=1
stride=1
pad=1
activation=leaky
[maxpool]
size=2
stride=2
[convolutional]
filters=21
size=1
stride=1
pad=1
activation=linear
[yolo]
mask = 0,1,2
[route]
layers = -3
[upsample]
stride=2
[route]
layers = -1, 0
[convolutional]
filters=21
size=1
stride=1
pad=1
activation=linear
[yolo]
mask = 3,4,5
"""


def weight_file(values):
    return (
        np.array([0, 2, 0], np.int32).tobytes() + np.int64(0).tobytes() + values.astype(np.float32).tobytes()
    )


def test_every_block_computes_what_darknet_does(tmp_path):
    rng = np.random.default_rng(0)
    sizes = [2, 6, 6, 21, 42, 21, 84]  # bias; scale, mean, variance; kernel; then two plain convolutions
    bias, norm, k1, b2, k2, b3, k3 = (rng.uniform(0.1, 1, n).astype(np.float32) for n in sizes)
    path = convert_darknet(
        CONFIGURATION, weight_file(np.concatenate([bias, norm, k1, b2, k2, b3, k3])), tmp_path / "m.onnx"
    )
    x = rng.normal(size=(1, 3, 8, 8)).astype(np.float32)
    low, high = ort.InferenceSession(str(path)).run(None, {"images": x})

    def convolve(kernel, picture):
        return np.einsum("oc,chw->ohw", kernel.reshape(-1, len(picture)), picture)

    scale, mean, variance = (v[:, None, None] for v in norm.reshape(3, 2))
    a = (convolve(k1, x[0]) - mean) / np.sqrt(variance + 1e-5) * scale + bias[:, None, None]
    a = np.where(a > 0, a, 0.1 * a)
    pooled = a.reshape(2, 4, 2, 4, 2).max(axis=(2, 4))
    np.testing.assert_allclose(low[0], convolve(k2, pooled) + b2[:, None, None], atol=1e-4)
    both = np.concatenate([pooled.repeat(2, axis=1).repeat(2, axis=2), a])
    np.testing.assert_allclose(high[0], convolve(k3, both) + b3[:, None, None], atol=1e-4)


@pytest.mark.parametrize(("n", "message"), [(100, "ends early"), (400, "left over")])
def test_weights_of_another_network(n, message, tmp_path):
    with pytest.raises(UserError, match=message):
        convert_darknet(CONFIGURATION, weight_file(np.ones(n)), tmp_path / "m.onnx")
    assert not (tmp_path / "m.onnx").exists()


def test_unknown_blocks(tmp_path):
    with pytest.raises(UserError, match="'shortcut' are not known"):
        convert_darknet("[net]\n[shortcut]\nfrom=-3\n", weight_file(np.ones(1)), tmp_path / "m.onnx")


def test_configuration_keeps_order_and_drops_comments():
    blocks = parse_configuration("[net]\na=1 # one\n\n[yolo]\n b = 2\n")
    assert blocks == [{"type": "net", "a": "1"}, {"type": "yolo", "b": "2"}]
