"""Every C file is formatted by clang-format with the tree's configuration."""

import pytest

from tree import ROOT, files, name, run


@pytest.mark.parametrize("path", files(".c", ".h"), ids=name)
def test_formatted(path):
    run("clang-format-19", "--dry-run", "--Werror", f"--style=file:{ROOT}/.clang-format", path)
