"""The readers by themselves: whatever they are given, an answer or ValueError in bounded memory."""

import contextlib
import csv
import io
import json
import os
import pathlib
import socket
import tracemalloc
import zipfile

import hypothesis
import hypothesis.extra.numpy as arrays
import numpy as np
import pytest
from hypothesis import strategies as st

from hitl_jax.errors import ResultsError
from hitl_jax.live import messages
from hitl_jax.results import episode_tables, json_documents, npz_archives, recorded_episodes
from hitl_jax.results.atomic_files import read_bytes
from hitl_jax.results.json_documents import from_json, to_json
from hitl_jax.results.schemas import FolderDocument, RunDocument, SaveHead

many = hypothesis.settings(max_examples=300, deadline=None, derandomize=True)


def _refusal(read, *given):
    """What a reader says of what it refuses; None if it does not."""
    try:
        read(*given)
    except (ValueError, csv.Error) as error:
        return str(error)
    return None


@contextlib.contextmanager
def _at_most(size):
    """Within, no more memory than that is ever taken [bytes]."""
    tracemalloc.start()
    try:
        yield
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < size


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda one: st.lists(one, max_size=4) | st.dictionaries(st.text(max_size=10), one, max_size=4),
    max_leaves=30,
)


@many
@hypothesis.given(st.binary(max_size=300) | _JSON.map(lambda value: json.dumps(value).encode()))
def test_json_of_any_kind(data):
    for schema in (FolderDocument, RunDocument, SaveHead):
        with pytest.raises(ValueError, match=r"\A[ -~]+\Z"):
            from_json(data, schema)
    said = _refusal(messages.parse, data)
    assert said is None or "\n" not in said


@many
@hypothesis.given(st.dictionaries(st.text(max_size=10), _JSON, max_size=5))
def test_a_document_comes_back_or_is_refused(document):
    try:
        text = to_json(document)
    except ValueError:  # NaN is no JSON.
        return
    expected = json.loads(text)
    expected.pop("digest")
    said = _refusal(from_json, text.encode(), dict)
    assert from_json(text.encode(), dict) == expected if said is None else said.isprintable()


@pytest.mark.parametrize("depth", [13, 500, 100_000])
@pytest.mark.parametrize("opening", ["[", '{"a":'])
def test_deep_json_is_refused(depth, opening):
    text = opening * depth + "1" + ("]" if opening == "[" else "}") * depth
    with pytest.raises(ValueError, match=r"nested too deep|Expected `object`"):
        from_json(f'{{"format":1,"a":{text}}}'.encode(), dict)


def test_what_a_terminal_would_obey_is_neither_read_nor_written():
    for text in ("\x1b[2J", "a\rb", "\x9b1m", "a\nb"):
        for document in ({"versions": {"jax": text}}, {"versions": {text: "1"}}):
            with pytest.raises(ValueError, match="control characters"):
                to_json(document)
            with pytest.raises(ValueError, match="control characters"):
                from_json(json.dumps({"format": 1, **document}).encode(), dict)


@many
@hypothesis.given(
    st.dictionaries(
        st.text(st.characters(codec="ascii", exclude_characters="/\0"), min_size=1, max_size=9),
        arrays.arrays(
            st.sampled_from([np.float32, np.float64, np.int64, np.uint8, np.bool_]),
            arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4),
            elements={"allow_nan": False},
        ),
        max_size=4,
    )
)
def test_arrays_come_back_as_they_were(told):
    hypothesis.assume(not {"file", "allow_pickle"} & told.keys())
    hypothesis.assume(not any(name.endswith(".npy") for name in told))
    found = npz_archives.from_npz(npz_archives.to_npz(told))
    assert found.keys() == told.keys()
    for name, array in told.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype
        assert found[name].flags.writeable


@pytest.mark.parametrize(
    ("array", "said"),
    [
        (np.zeros(3, ">f4"), "no numbers"),
        (np.zeros(3, np.longdouble), "no numbers"),
        (np.zeros(3, np.complex64), "no numbers"),
        (np.array(["a"]), "no numbers"),
        (np.full(3, 7, np.uint8).view(bool), "truth values that are none"),
    ],
)
def test_numbers_that_we_do_not_write_are_refused(array, said):
    with pytest.raises(ValueError, match=said):
        npz_archives.from_npz(npz_archives.to_npz({"w": array}))


def test_an_old_header_is_refused_without_a_warning():
    data = npz_archives.to_npz({"w": np.zeros(3)}).replace(b"(3,)", b"(3L)")
    with pytest.raises(ValueError, match=r"Warning|header|CRC"):
        npz_archives.from_npz(data)


def test_a_document_with_a_digest_is_held_to_it_whatever_its_format():
    text = to_json({"config": {"gamma": 0.5}})
    for changed in (text.replace("0.5", "0.6"), text.replace("0.5", "0.6").replace("2,", "1,", 1)):
        with pytest.raises(ValueError, match="its digest is not"):
            from_json(changed.encode(), dict)


def test_a_long_cell_costs_no_memory():
    head = ",".join(episode_tables.EPISODE_COLUMNS) + "\n"
    row = ",".join(["1"] * len(episode_tables.EPISODE_COLUMNS)) + "\n"
    text = head + row * 6000 + "1" * 100_000 + row
    with _at_most(60 * 2**20), pytest.raises(ValueError, match="line 6002 has a cell of more"):
        episode_tables.table_from_csv(text, episode_tables.EPISODE_COLUMNS)


@many
@hypothesis.given(st.binary(max_size=400))
def test_bytes_of_any_kind_are_no_arrays(data):
    with pytest.raises(ValueError, match=r"(?s)."):
        npz_archives.from_npz(data)


def _bomb(size: int) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, w=np.zeros(size, np.uint8))
    return file.getvalue()


def _many_entries() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(2000):
            archive.writestr(f"{number}.npy", b"\0" * 100_000)
    return file.getvalue()


def _twice() -> bytes:
    file = io.BytesIO()
    np.savez(file, v=np.zeros(3), w=np.ones(3))
    return file.getvalue().replace(b"v.npy", b"w.npy")


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (_bomb(200_000_000), "unpacks to 200,000,128 bytes"),
        (_many_entries(), "unpacks to 200,000,000 bytes"),
        (_twice(), "entry 'w.npy': must be an array, once"),
    ],
    ids=["one", "many", "twice"],  # Or their bytes, which differ from process to process.
)
def test_what_unpacks_to_more_than_it_should_costs_nothing(data, said):
    assert len(data) < 2**21
    with _at_most(4 * 2**20), pytest.raises(ValueError, match=said):
        npz_archives.from_npz(data)
    with _at_most(4 * 2**20), pytest.raises(ValueError, match=r"no recorded episode|once|magic"):
        recorded_episodes.from_npz(data, np.array([5]))


def test_recordings_are_looked_at_before_they_are_unpacked():
    """One whose size is allowed, but longer than any episode."""
    file = io.BytesIO()
    steps = np.zeros((10**6, 9), np.float32)
    np.savez_compressed(file, **{"best/episode": np.array(1), "best/steps": steps})
    refused = pytest.raises(ValueError, match="are more than of any episode")
    with _at_most(2**20), refused:
        recorded_episodes.from_npz(file.getvalue(), np.array([1600]))


@many
@hypothesis.given(st.text(max_size=200))
def test_text_of_any_kind_is_no_table(text):
    for rest in ("", ",".join(episode_tables.EPISODE_COLUMNS) + "\n"):
        said = _refusal(episode_tables.table_from_csv, rest + text, episode_tables.EPISODE_COLUMNS)
        assert said is None or "\n" not in said


@pytest.mark.parametrize("kind", ["fifo", "folder", "device", "socket", "dangling", "loop"])
def test_what_is_no_file_is_not_waited_for(tmp_path, kind):
    path = tmp_path / "episodes.csv"
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "device":
        path = pathlib.Path("/dev/zero")
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(str(path))
    elif kind == "dangling":
        path.symlink_to(tmp_path / "none")
    else:
        path.symlink_to(path)
    with pytest.raises(ResultsError, match=r"must be a plain file|No such file|Is a directory"):
        read_bytes(path)


def test_a_file_that_is_too_large_is_not_read(tmp_path):
    path = tmp_path / "config.json"
    with open(path, "wb") as file:
        file.truncate(json_documents.LARGEST_JSON + 1)
    with pytest.raises(ResultsError, match="must be at most"):
        read_bytes(path, json_documents.LARGEST_JSON)
