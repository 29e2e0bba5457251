"""Fuzzes the readers by what of our code a file reaches, with atheris (not in CI; not an extra).

    pip install atheris
    python tests/attacks/fuzz.py CORPUS -max_total_time=3600

CORPUS is a folder for the files that reach something new. It starts with a whole file of every
format. An input is the number of a format, one byte, and the file. A finding is kept by atheris in
the current folder as `crash-…`; give its name instead of CORPUS to see it again.
"""

import pathlib
import sys
import tempfile

import atheris

sys.path += [str(pathlib.Path(__file__).parents[1]), str(pathlib.Path(__file__).parents[2])]

_READERS = (
    "results human.judgement team.checkpoint training.saved_run training.saved_run_store "
    "live.messages live.journal analysis.alarm_figures analysis.boundary_map live.recorded_person "
    "sweep.recorded_human sweep.shards playback.load_trained studies.tuning.table "
    "studies.ablations.store"
)
with atheris.instrument_imports(include=[f"hitl_jax.{name}" for name in _READERS.split()]):
    from damage import _read, plain
    from formats import FORMATS
    from made_files import make


def main() -> None:
    """Fuzzes until told to stop."""
    root = pathlib.Path(tempfile.mkdtemp())
    make(root)
    whole = {form.name: plain(form.read(root)) for form in FORMATS}
    before = {form.name: (root / form.path).read_bytes() for form in FORMATS}
    corpus = pathlib.Path(next((word for word in sys.argv[1:] if not word.startswith("-")), "."))
    if not corpus.is_file():
        corpus.mkdir(parents=True, exist_ok=True)
        for number, form in enumerate(FORMATS):
            (corpus / f"whole-{number}").write_bytes(bytes([number]) + before[form.name])

    def one(data: bytes) -> None:
        if not data:
            return
        form = FORMATS[data[0] % len(FORMATS)]
        path = root / form.path
        path.write_bytes(data[1:])
        try:
            files = before[form.name], data[1:]
            verdict, told = _read(form, root, whole[form.name], files, form.name)
        finally:
            path.write_bytes(before[form.name])
        if verdict not in ("refused", "as it was", "another"):
            raise RuntimeError(f"{verdict}: {told}")

    atheris.Setup(sys.argv, one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
