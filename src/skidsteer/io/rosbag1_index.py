"""rosbag1 files: what one holds and where, from the index at its end or by searching a file that has none."""

from __future__ import annotations

from skidsteer.io.chunked import (
    BagIndex,
    ByteFile,
    Channel,
    Chunk,
    ChunkHead,
    DamagedError,
    Format,
    chunk_records,
    count_messages,
    ros2_type,
    with_channel,
)
from skidsteer.io.raw import Definition
from skidsteer.io.rosbag1_records import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    INDEX,
    MAGIC,
    MAX_HEADER,
    MESSAGE,
    Record,
    fields_of,
    message_starts,
    parse_message_indexes,
    parse_messages,
    parse_records,
    read_record,
    unpack_chunk,
)

_MAX_INDEX = 256 << 20
_MAX_DEFINITION = 16 << 20
_FEW = 512  # bytes, enough for the header of nearly all records


def index_rosbag1(file: ByteFile) -> BagIndex:
    """Find out what a file holds: by its own index where that is complete and sound, else by going through it."""
    notes = []
    try:
        index = _from_end(file)
    except DamagedError as error:
        index, notes = None, [f"{file.path.name}: its index is damaged ({error}); the file was searched instead"]
    if index is None:
        index = _from_scan(file)
        _look_into_chunks(file, index)
    index.notes[:0] = notes
    return index


def _chunk_head(file: ByteFile, chunk: Chunk) -> ChunkHead:
    record = _record(file, chunk.start)
    if record.op != CHUNK or (record.end > chunk.start + chunk.size and not chunk.cut):
        raise DamagedError("a chunk is not one")
    compression = record.text("compression")
    packed = min(record.end, file.size) - record.data
    size = record.number("size")
    if chunk.cut and size == 0:
        size = packed
    return ChunkHead(record.data, packed, size, "" if compression == "none" else compression)


ROSBAG1 = Format(
    "rosbag1", index_rosbag1, _chunk_head, unpack_chunk, parse_message_indexes, message_starts, parse_messages
)


def _record(file: ByteFile, position: int) -> Record:
    """The header of the record at ``position``, and where its data lie in the file."""
    try:
        return read_record(file.read(position, _FEW), 0, position)
    except DamagedError:
        return read_record(file.read(position, MAX_HEADER + 8), 0, position)


def _connection(record: Record, data: bytes) -> tuple[int, Channel]:
    fields = fields_of(data)
    topic, type_name = (fields.get(name, b"").decode(errors="replace") for name in ("topic", "type"))
    text = fields.get("message_definition", b"").decode(errors="replace")
    definition = Definition("msg", text) if text else None
    return record.number("conn"), Channel(record.text("topic") or topic, ros2_type(type_name), "ros1", definition)


# --- from the index at the end of the file


def _from_end(file: ByteFile) -> BagIndex | None:
    header = _record(file, len(MAGIC))
    if header.op != BAG_HEADER:
        raise DamagedError("the file has no header")
    start = header.number("index_pos")
    if start == 0:
        return None
    if start > file.size or file.size - start > _MAX_INDEX:
        raise DamagedError("it lies outside the file")
    index, chunks = BagIndex(), []
    data = file.read(start, file.size - start)
    for record in parse_records(data):
        if record.op == CONNECTION:
            key, channel = _connection(record, data[record.data : record.end])
            index.channels[key] = channel
        elif record.op == CHUNK_INFO:
            chunks.append((record.number("chunk_pos"), _counts(data[record.data : record.end])))
    if (len(index.channels), len(chunks)) != (header.number("conn_count"), header.number("chunk_count")):
        raise DamagedError("it is not complete")
    _add_chunks(file, index, sorted(chunks, key=lambda chunk: chunk[0]), start)
    return index


def _counts(data: bytes) -> dict[int, int]:
    """Messages by connection in one chunk."""
    numbers = [int.from_bytes(data[at : at + 4], "little") for at in range(0, len(data) - 3, 4)]
    return dict(zip(numbers[::2], numbers[1::2], strict=False))


def _add_chunks(file: ByteFile, index: BagIndex, chunks: list[tuple[int, dict[int, int]]], end: int) -> None:
    """Take in the chunks; between one and the next lies the index of its messages."""
    nexts = [*(start for start, _ in chunks), end][1:]
    for (start, counts), following in zip(chunks, nexts, strict=True):
        record = _record(file, start)
        if record.op != CHUNK or not start < record.end <= following <= end:
            raise DamagedError("it points to no chunk")
        size = record.end - start
        index.chunks.append(Chunk(start, size, record.end, following - record.end, frozenset(counts)))
        index.counts.update(counts)


# --- by going through the file


def _from_scan(file: ByteFile) -> BagIndex:
    """Go from record to record, without opening chunks."""
    index, position = BagIndex(finished=False), len(MAGIC)
    while position < file.size:
        try:
            record = _record(file, position)
        except DamagedError:
            break
        if record.end > file.size:
            if record.op == CHUNK:
                index.chunks.append(Chunk(position, file.size - position, 0, 0, None, cut=True))
            break
        _take_record(file, index, record)
        position = record.end
    index.notes.append(f"{file.path.name}: has no usable index, whole as far as byte {position} of {file.size}")
    return index


def _take_record(file: ByteFile, index: BagIndex, record: Record) -> None:
    size = record.end - record.start
    try:
        if record.op == CHUNK:
            index.chunks.append(Chunk(record.start, size, record.end, 0, None))
        elif record.op == INDEX and index.chunks and _follows(index.chunks[-1], record):
            index.chunks[-1] = with_channel(index.chunks[-1], record.number("conn"), size)
        elif record.op == MESSAGE:
            index.add_loose(record.number("conn"), record.start, record.end)
        elif record.op == CONNECTION and size <= _MAX_DEFINITION:
            key, channel = _connection(record, file.read(record.data, record.end - record.data))
            index.channels.setdefault(key, channel)
    except DamagedError as error:
        index.notes.append(f"{file.path.name}: a record is damaged and was left out ({error})")


def _follows(chunk: Chunk, record: Record) -> bool:
    return record.start == chunk.index_start + chunk.index_size


def _look_into_chunks(file: ByteFile, index: BagIndex) -> None:
    """Open the chunks with connections that nothing outside of them describes, and count the messages of all."""
    for chunk in index.chunks:
        try:
            if chunk.channels is not None and chunk.channels <= index.channels.keys():
                index.counts.update(count_messages(file, ROSBAG1, chunk))
                continue
            data = chunk_records(file, ROSBAG1, chunk)
            for record in parse_records(data):
                if record.op == CONNECTION:
                    key, channel = _connection(record, data[record.data : record.end])
                    index.channels.setdefault(key, channel)
            index.counts.update(count_messages(file, ROSBAG1, chunk, data))
        except DamagedError as error:
            index.lost[chunk.start] = str(error)
