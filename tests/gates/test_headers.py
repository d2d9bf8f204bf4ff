"""Every public header compiles by itself, as C11 and as C++17, with both compilers."""

import pytest

from tree import FIRMWARE, ROOT, files, name, run

WARNINGS = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"]
LANGUAGES = {"c": "-std=c11", "c++": "-std=c++17"}
HEADERS = files(".h", under=FIRMWARE / "include") + files(".h", under=ROOT / "hal" / "include")


@pytest.mark.parametrize("compiler", ["gcc", "clang-19"])
@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("path", HEADERS, ids=name)
def test_compiles_alone(path, language, compiler, tmp_path):
    source = tmp_path / "alone"
    # Twice, because the include guard is part of the promise.
    source.write_text(f'#include "{path}"\n#include "{path}"\n')
    folders = ["-I", FIRMWARE / "include", "-I", ROOT / "hal" / "include"]
    run(
        compiler, "-x", language, LANGUAGES[language], *WARNINGS, *folders, "-fsyntax-only", source
    )
