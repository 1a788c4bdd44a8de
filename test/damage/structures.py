"""Damage that keeps a file's structure, so that it comes behind the first check.

Each function takes a sound or damaged input and a source of chance and gives another input. What
does not parse as it should comes back cut or with a byte changed.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
import gzip
from io import BytesIO
import json
from pathlib import Path
from random import Random
import re
import sqlite3
import struct
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias
from zipfile import ZIP_DEFLATED, BadZipFile, ZipFile
import zlib

import yaml

Mutate: TypeAlias = Callable[[bytes, Random], bytes]

MOST_GROWTH = 64
"""Times that a part is repeated: limits and ratios lie beyond what single bytes reach."""

SIZES = (
    *(0, 1, 0xFF, 0xFFFF, 1 << 20, (1 << 27) + 1, (1 << 31) - 1, 1 << 32, 1 << 63),
    (1 << 64) - 1,
)
VALUES: tuple[Any, ...] = (
    *(0, -1, 1, 2**31, 2**63, 2**64, 10**400, -(10**400), 0.0, 5e-324, 1e300, -1e300, 1.7e308),
    *(True, None, "", "x" * 2000, "\x1b[31m", "\ud7ff\u202e", "nan", "190:20:30", "0x10", "1e3"),
    *([], {}, [[]], [[1.0], [2.0, 3.0]], {"a": {"b": {}}}),
)
CELLS = (
    *("", '"', '""', '"a', "nan", "inf", "-inf", "1e308", "-1e308", "1,5", "1.234,5", "9" * 400),
    *("0x10", "2025-02-30", "31.12.2024 23:59:60", "1700000000000", "1e18", "=1+1", "\x1b[2J"),
    *("km/h", "mph", "sep=;", "\ufeff", "\u221212", "\u0661\u0662", "\u00a01", "1\u202f000"),
    *("TRUE", "-", "n/a", "7FFFFFFFx", "-1", "0", "  ", "(", "base dec timestamps relative"),
    "5e-324",
)

LINES = (
    *("a: &a [*a]", "a: &a [x]\nb: *a", "<<: {a: 1}", "x: !!python/name:os.system", "--- a"),
    *("a: 190:20:30:15", "t: 2001-12-14t21:59:43.10-05:00", "? [a, b]\n: c", "%YAML 9.9"),
    *("a: " + "[" * 50, "a: " + "9" * 3000, "\t- x", "a: |\n  x", "a: {b: 1, b: 2}", "..."),
)


def _field(body: bytes, chance: Random) -> bytes:
    """A number of two, four or eight bytes replaced by one at the ends of its range."""
    width = chance.choice((2, 4, 8))
    if len(body) < width:
        return body + bytes(width)
    at = chance.randrange(len(body) - width + 1)
    number = (chance.choice(SIZES) & ((1 << 8 * width) - 1)).to_bytes(width, "little")
    return body[:at] + number + body[at + width :]


def mutate_json(data: bytes, chance: Random) -> bytes:
    """A state with other values, keys or shapes."""
    try:
        value = json.loads(data)
    except (ValueError, RecursionError):
        return _any(data, chance)
    for _ in range(chance.randint(1, 3)):
        value = _changed(value, chance)
    text = json.dumps(value)
    if not chance.randrange(20):
        text = "[" * 5000 + text
    return text.replace("1.7e+308", chance.choice(("1e999", "NaN", "9" * 5000))).encode()


def mutate_yaml(data: bytes, chance: Random) -> bytes:
    """A settings file with other values, keys or shapes; or lines that YAML alone knows."""
    try:
        value = yaml.safe_load(data)
    except (yaml.YAMLError, ValueError, RecursionError):
        return _any(data, chance)
    if chance.randrange(3):
        return yaml.safe_dump(_changed(value, chance), sort_keys=False).encode("utf-8", "replace")
    lines = data.decode("utf-8", "replace").splitlines()
    line = chance.choice(LINES)
    lines.insert(chance.randint(0, len(lines)), " " * chance.choice((0, 0, 2, 4)) + line)
    return "\n".join(lines).encode()


def _changed(value: Any, chance: Random) -> Any:
    """The value with one place in it, chosen level by level, replaced, removed or repeated."""
    if isinstance(value, dict) and value and chance.randrange(8):
        key = chance.choice(list(value))
        what = chance.randrange(8)
        if what == 0:
            return {name: inner for name, inner in value.items() if name != key}
        if what == 1:
            return {**value, str(chance.choice(CELLS)): value[key]}
        return {**value, key: _changed(value[key], chance)}
    if isinstance(value, list) and value and chance.randrange(8):
        at = chance.randrange(len(value))
        what = chance.randrange(8)
        if what == 0:
            return [*value[:at], *value[at + 1 :]]
        if what == 1:
            return [*value[:at], *[value[at]] * chance.choice((2, MOST_GROWTH)), *value[at:]]
        return [*value[:at], _changed(value[at], chance), *value[at + 1 :]]
    if isinstance(value, float) and chance.randrange(2):
        return value * chance.choice((-1.0, 0.0, 1e6, 1e-6))
    return chance.choice(VALUES)


def mutate_table(data: bytes, chance: Random) -> bytes:
    """A table with other cells, columns, separators or encoding."""
    text = data.decode("utf-8", "replace")
    separator = max(",;\t", key=text.count)
    rows = [line.split(separator) for line in text.splitlines()] or [[""]]
    for _ in range(chance.randint(1, 4)):
        _change_table(rows, chance)
    separator = chance.choice((separator, separator, ",", ";", "\t", "|"))
    ending = chance.choice(("\n", "\n", "\r\n", "\r"))
    written = ending.join(separator.join(row) for row in rows)
    encoding = chance.choice(("utf-8", "utf-8", "utf-8", "utf-8-sig", "utf-16", "cp1252"))
    return written.encode(encoding, "replace")


def mutate_packed(data: bytes, chance: Random) -> bytes:
    """A gzip or zip file that is damaged inside its packing: its checksums are right."""
    try:
        if data[:2] == b"\x1f\x8b":
            return gzip.compress(flipped(gzip.decompress(data), chance), mtime=0)
        with ZipFile(BytesIO(data)) as whole:
            members = {name: whole.read(name) for name in whole.namelist()}
    except (OSError, EOFError, ValueError, RuntimeError, zlib.error, struct.error, BadZipFile):
        return _any(data, chance)
    if members:
        name = chance.choice(sorted(members))
        members[name] = flipped(members[name], chance)
    with ZipFile(file := BytesIO(), "w", ZIP_DEFLATED) as whole:
        for name, content in members.items():
            whole.writestr(name, content)
    return file.getvalue()


def mutate_text(data: bytes, chance: Random) -> bytes:
    """Lines with other words, or in another order."""
    lines = data.decode("utf-8", "surrogateescape").splitlines(keepends=True) or [""]
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(lines))
        words = re.split(r"([\s,;:<>=/()|\[\]\"]+)", lines[at])
        word = chance.randrange(len(words))
        words[word : word + chance.randint(0, 2)] = [chance.choice((*CELLS, *words))]
        changed = "".join(words)
        repeated = [changed] * (MOST_GROWTH if len(changed) < MOST_GROWTH**2 else 2)
        some = chance.choice(([changed], [changed], [], repeated, lines[at:]))
        lines[at : at + chance.choice((0, 1, 1, 1, 5))] = some
        lines = lines or [""]
    return "".join(lines).encode("utf-8", "surrogateescape")


def mutate_plan(data: bytes, chance: Random) -> bytes:
    """A route of a service, or a track."""
    return (mutate_text if data[:1] == b"<" else mutate_json)(data, chance)


def mutate_mcap(data: bytes, chance: Random) -> bytes:
    """An MCAP file with other records, those inside an unpacked chunk included."""
    magic, chunk, head = 8, 6, 9  # bytes, opcode, bytes of opcode and length
    records, at = [], magic
    while at + head < len(data) - magic:
        size = int.from_bytes(data[at + 1 : at + head], "little")
        records.append((data[at], data[at + head : at + head + size]))
        at += head + size
    if not records:
        return _any(data, chance)
    place = chance.randrange(len(records))
    opcode, body = records[place]
    if opcode == chunk and chance.randrange(2):  # times, size, no checksum, compression
        body = body[:24] + bytes(4) + flipped(body[28:], chance)
    elif chance.randrange(2):
        body = flipped(body, chance)
    else:
        opcode = chance.choice((opcode, chance.randrange(1, 16)))
        records.insert(chance.randrange(len(records)), chance.choice(records))
    records[place : place + chance.choice((0, 1, 1, 1))] = [(opcode, body)]
    packed = (bytes((kind,)) + struct.pack("<Q", len(body)) + body for kind, body in records)
    return data[:magic] + b"".join(packed) + data[:magic]


SHAPES = (
    "CREATE VIEW other AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
    "SELECT i FROM n",
    "ALTER TABLE {table} ADD other GENERATED ALWAYS AS (zeroblob(1000))",
    "ALTER TABLE {table} DROP COLUMN {column}; ALTER TABLE {table} ADD {column} DEFAULT 'x'",
    "CREATE TRIGGER other AFTER INSERT ON {table} BEGIN SELECT 1; END",
    "CREATE VIRTUAL TABLE other USING fts5(a)",
    "CREATE TABLE other(a PRIMARY KEY, b) WITHOUT ROWID",
    "CREATE TABLE t AS SELECT * FROM {table}; DROP TABLE {table}; ALTER TABLE t RENAME TO {table}",
    "ALTER TABLE {table} RENAME TO t; CREATE VIEW {table} AS SELECT * FROM t",
    "ALTER TABLE {table} RENAME TO t;CREATE TABLE {table} AS SELECT t.* FROM t, t AS u LIMIT 2000",
    "ALTER TABLE {table} RENAME COLUMN {column} TO other",
    "CREATE INDEX other ON {table} ({column})",
    "CREATE INDEX other ON {table} ({column} || zeroblob(1000))",
    "CREATE UNIQUE INDEX other ON {table} (rowid) WHERE {column} > 1",
    "WITH RECURSIVE n(i) AS (SELECT 9 UNION ALL SELECT i + 1 FROM n LIMIT 12000) "
    "INSERT INTO {table}({column}) SELECT i FROM n",
    "DROP TABLE {table}",
    "PRAGMA writable_schema = 1; UPDATE sqlite_master SET rootpage = {number} "
    "WHERE name = '{table}'",
    "PRAGMA writable_schema = 1; UPDATE sqlite_master SET sql = sql || '{column}'",
    "PRAGMA writable_schema = 1; UPDATE sqlite_master SET type = 'view' WHERE name = '{table}'",
    "PRAGMA writable_schema = 1; INSERT INTO sqlite_master SELECT * FROM sqlite_master",
    "PRAGMA page_size = 512; VACUUM; PRAGMA journal_mode = WAL",
    "PRAGMA auto_vacuum = 2; VACUUM",
    "PRAGMA encoding = 'UTF-16'; VACUUM",
    "DELETE FROM {table} WHERE rowid % 2",
)
"""What SQLite itself makes of a table."""


def mutate_database(data: bytes, chance: Random) -> bytes:
    """A sqlite3 file of other cells, rows or tables, or whose pages lead elsewhere."""
    if not chance.randrange(4):
        return _mutate_pages(data, chance)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "drive.db3"
        path.write_bytes(data)
        with closing(sqlite3.connect(path)) as file:
            try:
                tables = [name for (name,) in file.execute("SELECT name FROM sqlite_master")]
                table = chance.choice(tables)
                columns = [row[1] for row in file.execute(f'PRAGMA table_info("{table}")')]
                column = chance.choice(columns or ["rowid"])
                value = chance.choice((*VALUES[:13], *CELLS, bytes(9), chance.randbytes(40)))
                value = value if not isinstance(value, int) or abs(value) < 2**63 else str(value)
                if chance.randrange(2):
                    number = chance.choice((0, 1, 2, 3, 2**40))
                    shape = chance.choice(SHAPES)
                    file.executescript(shape.format(table=table, column=column, number=number))
                else:
                    statement = chance.choice(
                        (
                            f'UPDATE "{table}" SET "{column}" = ?',
                            f'UPDATE "{table}" SET "{column}" = ? WHERE rowid % 3 = 1',
                            f'INSERT OR REPLACE INTO "{table}" ("{column}") VALUES (?)',
                        )
                    )
                    file.execute(statement, (value,))
                file.commit()
            except (sqlite3.Error, UnicodeError, IndexError):
                return flipped(data, chance)
        return path.read_bytes()


def _mutate_pages(data: bytes, chance: Random) -> bytes:
    """Pages in place of others, cells that are one, links to other pages."""
    (size,) = struct.unpack_from(">H", data.ljust(18, b"\0"), 16)
    if size < 512 or len(data) < 2 * size:
        return flipped(data, chance)
    pages = [bytearray(data[at : at + size]) for at in range(0, len(data), size)]
    place = chance.randrange(len(pages))
    page, begin = pages[place], 100 if place == 0 else 0
    what = chance.randrange(5)
    if what == 0 and place:
        pages[place] = chance.choice(pages[1:])
    elif what == 1:
        pages += pages[1:] * chance.choice((1, 8))
    elif what == 2:  # a link of overflow, or to the right
        at = chance.choice((begin, begin + 8))
        page[at : at + 4] = struct.pack(">I", chance.randrange(len(pages) + 2))
    elif what == 3:
        page[begin] = chance.choice((0, 2, 5, 10, 13))
    elif what == 4:
        count = chance.choice((1, 100, size // 2 - 60))
        first = page[begin + 8 : begin + 10]
        page[begin + 3 : begin + 5] = struct.pack(">H", count)
        page[begin + 8 : begin + 8 + 2 * count] = first * count
    content = bytearray(b"".join(page[:size].ljust(size, b"\0") for page in pages))
    content[28:32] = struct.pack(">I", len(pages))
    return bytes(content)


def mutate_blf(data: bytes, chance: Random) -> bytes:
    """A .blf with other objects: inside a container, which is packed again, or in its header."""
    header, packed_at = int.from_bytes(data[4:8], "little"), 32
    at = data.find(b"LOBJ", header)
    if at < 0 or not chance.randrange(4):
        return flipped(data, chance)
    size = int.from_bytes(data[at + 8 : at + 12], "little")
    try:
        inside = zlib.decompress(data[at + packed_at : at + size])
    except zlib.error:
        return flipped(data, chance)
    changed = flipped(inside, chance)
    if objects := inside.split(b"LOBJ")[1:]:
        place = chance.randrange(len(objects))
        objects[place] = flipped(objects[place], chance)
        objects.insert(chance.randrange(len(objects)), chance.choice(objects))
        changed = chance.choice((changed, b"LOBJ" + b"LOBJ".join(objects)))
    packed = zlib.compress(changed)
    claimed = chance.choice((len(changed), len(changed), 0, 2**32 - 1))
    head = struct.pack("<IIHHI", packed_at + len(packed), 10, 2, 0, 0)
    whole = data[: at + 8] + head + struct.pack("<II", claimed, 0)
    return whole + packed + bytes(len(packed) % 4) + data[at + size + size % 4 :]


def mutate_mf4(data: bytes, chance: Random) -> bytes:
    """An .mf4 whose blocks lead to others, have another size or other content."""
    changed = bytearray(data)
    blocks = [match.start() for match in re.finditer(rb"##[A-Z]{2}\0{4}", data)]
    if not blocks:
        return _any(data, chance)
    block = chance.choice(blocks)
    links = min(int.from_bytes(data[block + 16 : block + 24], "little"), 20)
    number = chance.choice((*SIZES, *blocks, len(data)))
    place = block + 8 * chance.choice((1, 2, *range(3, 3 + links)))
    changed[place : place + 8] = struct.pack("<Q", number & (2**64 - 1))
    return chance.choice((bytes(changed), bytes(changed), flipped(data, chance)))


def flipped(data: bytes, chance: Random) -> bytes:
    """One to eight damages: a number at the end of its range, a part cut out or repeated."""
    for _ in range(chance.choice((1, 1, 2, 4, 8))):
        at = chance.randrange(len(data) + 1)
        part = data[at : at + chance.choice((1, 8, 64, 512))]
        repeated = part * chance.choice((0, 3, MOST_GROWTH))
        changed = data[:at] + repeated + data[at + len(part) :]
        data = chance.choice((_any(data, chance), _field(data, chance), changed))
    return data


def _change_table(rows: list[list[str]], chance: Random) -> None:
    row = chance.choice(rows)
    what = chance.randrange(8)
    if what == 0:
        rows.insert(0, [chance.choice(CELLS)] * chance.choice((0, 1, len(row))))
    elif what == 1:
        rows.remove(row)
    elif what == 2:
        rows[:] = rows * chance.choice((2, 8))
    elif what == 3:
        rows.reverse()
    elif what == 4:
        column = chance.randrange(max(map(len, rows), default=0) + 1)
        cell = chance.choice(CELLS)
        for changed in rows[chance.randint(0, 1) :]:
            changed[column : column + 1] = [cell]
    elif what == 5:
        rows[0][:] = [chance.choice((*rows[0], *CELLS)) for _ in rows[0]]
    elif row:
        row[chance.randrange(len(row))] = chance.choice(CELLS)
    if not rows:
        rows.append([""])


def _any(data: bytes, chance: Random) -> bytes:
    """A byte changed, or the end missing."""
    at = chance.randrange(len(data) + 1)
    return data[:at] + bytes((chance.randrange(256),)) * chance.randint(0, 1) + data[at + 1 :]
