from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bag_files import STORES, build
from skidsteer.errors import DataError
from skidsteer.io.layout import Decoder, LayoutError, fill, read_layout
from skidsteer.io.messages import TABLES, definitions_of, standard_definitions
from skidsteer.io.raw import BagTopic, Definition, RawMessages, from_list, join

TYPES = sorted(name for name in TABLES if not name.startswith("tf/"))
ENCODINGS = ("cdr-little", "cdr-big", "ros1")
finite = st.floats(-1e6, 1e6)
names = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)


def serialise(type_name: str, value: Any, encoding: str) -> bytes:
    store = STORES[1 if encoding == "ros1" else 2]
    message = build(store, type_name, value)
    if encoding == "ros1":
        return bytes(store.serialize_ros1(message, type_name))
    return bytes(store.serialize_cdr(message, type_name, little_endian=encoding == "cdr-little"))


def deserialise(type_name: str, data: bytes, encoding: str) -> Any:
    store = STORES[1 if encoding == "ros1" else 2]
    return store.deserialize_ros1(data, type_name) if encoding == "ros1" else store.deserialize_cdr(data, type_name)


def decoder(type_name: str, encoding: str) -> Decoder:
    ros1 = encoding == "ros1"
    return Decoder(standard_definitions(1 if ros1 else 2), type_name, "ros1" if ros1 else "cdr")


@st.composite
def values(draw: st.DrawFn, description: Any, store: Any) -> Any:
    """A random value of any field of any message."""
    kind, detail = int(description[0]), description[1]
    if kind == 2:
        return {
            name: draw(values(field, store)) for name, field in store.fielddefs[detail][1] if detail[-6:] != "Header"
        }
    if kind == 1:
        if detail[0] == "string":
            return draw(names)
        dtype = np.dtype(detail[0])
        return draw(finite) if dtype.kind == "f" else draw(st.integers(0, np.iinfo(dtype).max))
    inner, count = detail
    count = count if kind == 3 else draw(st.integers(0, 3))
    return [draw(values(inner, store)) for _ in range(count)]


def assert_same(block: Any, row: int, path: str, expected: Any) -> None:
    """Everything the library made of a message stands in that row of the block too."""
    for field in dataclasses.fields(expected):
        if field.name.startswith("__") or field.name.isupper():  # its type and its constants
            continue
        value, name = getattr(expected, field.name), path + field.name
        if hasattr(value, "__dataclass_fields__"):
            assert_same(block, row, name + ".", value)
        elif isinstance(value, str):
            assert block.text(name) == value
        elif isinstance(value, list):
            for index, item in enumerate(value):
                if isinstance(item, str):
                    assert block.text(f"{name}[{index}]") == item
                else:
                    assert_same(block, row, f"{name}[{index}].", item)
        else:
            np.testing.assert_array_equal(block.column(name)[row], value)


@pytest.mark.parametrize("type_name", TYPES)
@pytest.mark.parametrize("encoding", ENCODINGS)
@settings(max_examples=4, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_every_field_is_what_the_library_reads(type_name: str, encoding: str, data: st.DataObject) -> None:
    store = STORES[1 if encoding == "ros1" else 2]
    drawn = data.draw(st.lists(values((2, type_name), store), min_size=1, max_size=4))
    header = {"header": (data.draw(st.integers(0, 2**31 * 10**9 - 1)), data.draw(names))}
    messages = [serialise(type_name, value | header, encoding) for value in drawn]
    # The same message often: rows of one layout are decoded at once.
    messages += [messages[0]] * 3
    reader = decoder(type_name, encoding)
    seen = 0
    for block in reader.blocks(from_list(range(len(messages)), messages)):
        for row, message in enumerate(block.rows.tolist()):
            assert_same(block, row, "", deserialise(type_name, messages[message], encoding))
            seen += 1
    assert (seen, reader.undecoded) == (len(messages), 0)


@given(st.binary(min_size=1, max_size=12))
@settings(max_examples=20)
def test_bytes_after_the_end_are_trimmed(rest: bytes) -> None:
    message = serialise("geometry_msgs/msg/Twist", {"linear": {"x": 1.5}}, "cdr-little")
    (block,) = decoder("geometry_msgs/msg/Twist", "cdr").blocks(from_list([0], [message + rest]))
    assert block.column("linear.x").tolist() == [1.5]


def test_numbers_lie_where_the_standard_puts_them() -> None:
    # CDR by hand: encapsulation 4, sec 4, nanosec 4, length of "ab" + NUL 4, 3 bytes, padding to 8 from the 4th.
    message = serialise(
        "geometry_msgs/msg/TwistStamped", {"header": (7, "ab"), "twist": {"linear": {"x": 2.0}}}, "cdr-little"
    )
    layout = read_layout(message, standard_definitions(2), "geometry_msgs/msg/TwistStamped", "cdr")
    assert layout.fields["header.stamp.nanosec"].offset == 8
    assert layout.texts["header.frame_id"] == "ab"
    assert layout.fields["twist.linear.x"].offset == 4 + 16
    assert message[20:28] == np.float64(2.0).tobytes()
    assert layout.fixed == ((0, 2), (12, 19))


def test_custom_definition_of_the_bag_is_followed() -> None:
    definitions = {
        "x/msg/Ticks": (
            [],
            [("flag", (1, ("bool", 0))), ("count", (1, ("int64", 0))), ("more", (4, ((1, ("int16", 0)), 0)))],
        )
    }
    message = b"\0\1\0\0" + b"\1" + bytes(7) + (-5).to_bytes(8, "little", signed=True) + b"\2\0\0\0\3\0\4\0"
    (block,) = Decoder(definitions, "x/msg/Ticks", "cdr").blocks(from_list([0], [message]))
    assert block.column("count").tolist() == [-5]
    assert block.column("more").tolist() == [[3, 4]]


@given(st.lists(st.binary(max_size=6), min_size=1, max_size=20), st.lists(st.booleans(), min_size=20, max_size=20))
def test_messages_survive_being_chosen_packed_and_joined(messages: list[bytes], keep: list[bool]) -> None:
    def pairs(raw: RawMessages) -> list[tuple[int, bytes]]:
        rows = zip(raw.bag_ns.tolist(), raw.start.tolist(), raw.size.tolist(), strict=True)
        return sorted((ns, raw.buffer[start : start + size].tobytes()) for ns, start, size in rows)

    expected = [(index, message) for index, message in enumerate(messages) if keep[index]]
    chosen = from_list(range(len(messages)), messages).where(np.array(keep[: len(messages)]))
    packed = chosen.packed()
    assert pairs(packed) == expected
    assert packed.buffer.size == sum(len(message) for _, message in expected)
    assert pairs(join([packed, chosen])) == sorted(2 * expected)


def test_damaged_messages_are_left_out_and_counted() -> None:
    good = serialise("sensor_msgs/msg/JointState", {"name": ["l", "r"], "velocity": [1.0, 2.0]}, "cdr-little")
    absurd = bytearray(good)
    absurd[20:24] = b"\xff\xff\xff\x7f"  # the number of names
    cut, other = good[:-40], b"\0\7\0\0" + good[4:]
    reader = decoder("sensor_msgs/msg/JointState", "cdr")
    blocks = list(reader.blocks(from_list(range(5), [good, bytes(absurd), cut, other, good])))
    assert sorted(np.concatenate([block.rows for block in blocks]).tolist()) == [0, 4]
    assert reader.undecoded == 3


def test_many_layouts_cost_no_more_than_their_messages() -> None:
    messages = [
        serialise(
            "geometry_msgs/msg/PointStamped", {"header": (index, f"{index:06d}"), "point": {"x": index}}, "cdr-little"
        )
        for index in range(500)
    ]
    blocks = list(decoder("geometry_msgs/msg/PointStamped", "cdr").blocks(from_list(range(500), messages)))
    found = {int(row): float(x) for block in blocks for row, x in zip(block.rows, block.column("point.x"), strict=True)}
    assert found == {index: float(index) for index in range(500)}


def test_fill_is_the_inverse_of_column() -> None:
    message = serialise("sensor_msgs/msg/JointState", {"name": ["l", "r"], "velocity": [0.0, 0.0]}, "cdr-little")
    layout = read_layout(message, standard_definitions(2), "sensor_msgs/msg/JointState", "cdr")
    matrix = np.tile(np.frombuffer(message, dtype=np.uint8), (3, 1))
    rates = np.arange(6.0).reshape(3, 2)
    fill(matrix, layout.fields["velocity"], rates)
    back = [deserialise("sensor_msgs/msg/JointState", row.tobytes(), "cdr").velocity for row in matrix]
    np.testing.assert_array_equal(back, rates)


@pytest.mark.parametrize(
    ("message", "definitions", "encoding", "what"),
    [
        (b"", {}, "cdr", "not plain CDR"),
        (b"\0\1\0\0", {}, "cdr", "no definition of t"),
        (b"\0\1\0\0", {"t": ([], [("a", (2, "t"))])}, "cdr", "no definition of t"),  # a type inside itself
        (b"\0\1\0\0", {"t": ([], [("a", (1, ("wstring", 0)))])}, "cdr", "wstring cannot be decoded"),
        (b"", {}, "json", "encoding json"),
        (
            b"",
            {"t": ([], [("a", (3, ((2, "e"), 10**6)))]), "e": ([], [("b", (3, ((1, ("int8", 0)), 0)))])},
            "ros1",
            "fields",
        ),
    ],
)
def test_what_cannot_be_walked_says_why(message: bytes, definitions: Any, encoding: str, what: str) -> None:
    with pytest.raises(LayoutError, match=what):
        read_layout(message, definitions, "t", encoding)


IDL = """
module my_msgs { module msg {
  struct Ticks { boolean flag; int64 count; sequence<int16> more; };
}; };
"""


@pytest.mark.parametrize("text", [IDL, "=" * 80 + "\nIDL: my_msgs/msg/Ticks\n" + IDL])
def test_definitions_in_idl_are_read(text: str) -> None:
    definitions = definitions_of(BagTopic("/ticks", "my_msgs/msg/Ticks", 1, "cdr", Definition("idl", text)))
    message = b"\0\1\0\0" + b"\1" + bytes(7) + (7).to_bytes(8, "little") + b"\1\0\0\0\3\0"
    (block,) = Decoder(definitions, "my_msgs/msg/Ticks", "cdr").blocks(from_list([0], [message]))
    assert block.column("count").tolist() == [7]
    assert block.column("more").tolist() == [[3]]


def test_definition_that_is_none_says_so() -> None:
    with pytest.raises(DataError, match=r"the definition of a/msg/B in the bag cannot be parsed"):
        definitions_of(BagTopic("/b", "a/msg/B", 1, "cdr", Definition("idl", "module {")))
