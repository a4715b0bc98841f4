from __future__ import annotations

from pathlib import Path

import pytest
from results_data import tiny_records, write_run

from skysweep.results.run_folder import Run, load_run


@pytest.fixture
def tiny_folder(tmp_path: Path) -> Path:
    return write_run(tmp_path / "tiny", tiny_records())


@pytest.fixture
def tiny_run(tiny_folder: Path) -> Run:
    return load_run(tiny_folder)
