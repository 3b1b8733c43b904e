from __future__ import annotations

from tests.generated import generated


def test_the_generated_files_are_current() -> None:
    for path, text in generated().items():
        assert path.read_text("utf-8") == text, f"{path} is not current: run `make generated`"
