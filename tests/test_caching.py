"""Numba compiles and caches wherever skysweep is installed."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import skysweep
from skysweep.caching import first_writable

COMPILE = """
import os, skysweep
from skysweep.jitted import double
assert double(2) == 4
print(os.environ.get("NUMBA_CACHE_DIR", "numba's own"))
"""


def test_first_writable_makes_the_folder_and_skips_what_cannot_be_one(tmp_path):
    file = tmp_path / "file"
    file.touch()
    good = tmp_path / "a" / "b"
    assert first_writable([file / "below", good]) == good
    assert good.is_dir()
    assert list(good.iterdir()) == []
    assert first_writable([file / "below"]) is None


def test_installation_that_cannot_be_written_to_without_a_home_compiles(tmp_path):
    package = tmp_path / "skysweep"
    package.mkdir()
    for name in ("__init__.py", "caching.py"):
        shutil.copy(Path(skysweep.__file__).parent / name, package)
    (package / "jitted.py").write_text("import numba\n@numba.njit(cache=True)\ndef double(x): return 2 * x\n")
    (package / "__pycache__").touch()  # a file where the cache's folder would be stops root too
    environment = {"HOME": str(package / "__pycache__"), "PATH": os.environ["PATH"]}
    done = subprocess.run(
        [sys.executable, "-Bc", COMPILE],
        env=environment,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    used = Path(done.stdout.strip())
    assert used.name.startswith("skysweep-numba-")
    assert not used.exists(), "the temporary cache outlived its process"
