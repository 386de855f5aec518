"""A scratch copy of the workspace whose constants can be scaled at run time."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from gelstereo_bench.sensitivity.source import Definition, Source, sources

__all__ = ["BORROWED", "FIXED", "NESTED", "NOT_A_NUMBER", "build", "copy_workspace"]

FIXED = "fixes a size"
BORROWED = "borrowed as a whole table"
NESTED = "belongs to a type or a function"
NOT_A_NUMBER = "a record of several settings"

Key = tuple[str, str]

_NUMBER = re.compile(r"[fiu](?:8|16|32|64|size)")
_CORE = Path("crates/gelstereo-core/src")
_COPIED = (
    "Cargo.toml",
    "Cargo.lock",
    "crates",
    "firmware-host",
    "tests/same_bits",
    "python",
    "scenes",
    "docs",
    "examples",
)
_FACTORS = """//! Factors on constants.
use core::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};

pub static FACTORS: [AtomicU64; COUNT] = [const { AtomicU64::new(ONE) }; COUNT];
pub static READ: [AtomicBool; COUNT] = [const { AtomicBool::new(false) }; COUNT];
const ONE: u64 = 0x3ff0_0000_0000_0000;

pub trait Scaled {
    const FLOAT: bool;
    /// Integers beside floats count something else, and stay.
    fn scaled(self, factor: f64, integers: bool) -> Self;
}

#[inline(always)]
pub fn value<T: Scaled>(id: usize, default: T) -> T {
    READ[id].store(true, Relaxed);
    let bits = FACTORS[id].load(Relaxed);
    if bits == ONE { default } else { default.scaled(f64::from_bits(bits), !T::FLOAT) }
}

macro_rules! floats { ($($t:ty)*) => { $(impl Scaled for $t {
    const FLOAT: bool = true;
    fn scaled(self, factor: f64, _: bool) -> Self { (self as f64 * factor) as $t }
})* } }
floats!(f32 f64);

macro_rules! integers { ($($t:ty)*) => { $(impl Scaled for $t {
    const FLOAT: bool = false;
    fn scaled(self, factor: f64, integers: bool) -> Self {
        let scaled = libm::round(self as f64 * factor) as $t;
        if !integers { self }
        else if scaled != self { scaled }
        else if factor > 1.0 { self.saturating_add(1) }
        else { self.saturating_sub(1) }
    }
})* } }
integers!(u8 u16 u32 u64 usize i8 i16 i32 i64 isize);

impl<T: Scaled, const N: usize> Scaled for [T; N] {
    const FLOAT: bool = T::FLOAT;
    fn scaled(self, factor: f64, integers: bool) -> Self { self.map(|each| each.scaled(factor, integers)) }
}

impl<A: Scaled, B: Scaled> Scaled for (A, B) {
    const FLOAT: bool = A::FLOAT || B::FLOAT;
    fn scaled(self, factor: f64, integers: bool) -> Self {
        (self.0.scaled(factor, integers), self.1.scaled(factor, integers))
    }
}

impl<T: Scaled> Scaled for core::ops::RangeInclusive<T> {
    const FLOAT: bool = T::FLOAT;
    fn scaled(self, factor: f64, integers: bool) -> Self {
        let (from, to) = self.into_inner();
        from.scaled(factor, integers)..=to.scaled(factor, integers)
    }
}

impl<T: Scaled> Scaled for core::ops::Range<T> {
    const FLOAT: bool = T::FLOAT;
    fn scaled(self, factor: f64, integers: bool) -> Self {
        self.start.scaled(factor, integers)..self.end.scaled(factor, integers)
    }
}
"""
_DOORS = """
use core::sync::atomic::Ordering::Relaxed;
use gelstereo_core::factors;

#[unsafe(no_mangle)]
pub extern "C" fn gelstereo_scale_constant(id: u32, factor: f64) {
    factors::FACTORS[id as usize].store(factor.to_bits(), Relaxed);
}

#[unsafe(no_mangle)]
pub extern "C" fn gelstereo_constant_was_read(id: u32) -> u8 {
    u8::from(factors::READ[id as usize].swap(false, Relaxed))
}
"""


@dataclass
class _Site:
    """A place in a rewritten file that calls a constant."""

    keys: list[Key]
    start: int
    end: int


@dataclass
class _Rewriting:
    """Which constants are scaled, and which of them cannot be."""

    files: dict[str, Source]
    listed: list[Key]
    #: What cannot be scaled, and why.
    left: dict[Key, str] = field(default_factory=dict)
    sites: dict[str, list[_Site]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.by_key: dict[Key, Definition] = {}
        for source in self.files.values():
            for each in source.definitions:
                key = (each.file, each.name)
                # A test's constant of the same name comes later.
                if each.top and key not in self.by_key:
                    self.by_key[key] = each
        for key in self.listed:
            if key not in self.by_key:
                self.left[key] = NESTED
            elif not _NUMBER.search(self.by_key[key].type):
                self.left[key] = NOT_A_NUMBER
        self.derived: set[Key] = set()
        self.settle()

    def scaled(self, key: Key) -> bool:
        """Whether the constant is computed when it is asked for."""
        return key not in self.left and (key in self.derived or key in self.listed)

    def settle(self) -> None:
        """Constants that follow from scaled ones are computed as well; a scaled one may feed no fixed one."""
        changed = True
        while changed:
            changed = False
            for source in self.files.values():
                spans = [((d.file, d.name), d.start, d.end) for d in source.definitions]
                spans += [(("", ""), start, end) for start, end in source.statics]
                for key, start, end in spans:
                    fed = [k for at, name in source.names(start, end) for k in self.meant(source, at, name)]
                    if not fed or self.scaled(key):
                        continue
                    changed = True
                    own = self.by_key.get(key)
                    if own and own.start == start and key not in self.left and _NUMBER.search(own.type):
                        self.derived.add(key)
                    else:
                        self.left.update(dict.fromkeys(fed, FIXED))

    def meant(self, source: Source, at: int, name: str) -> list[Key]:
        """The scaled constants that a name may mean."""
        path = source.path(at)
        if not path:
            if (source.file, name) in self.by_key:
                return [(source.file, name)] if self.scaled((source.file, name)) else []
            if not re.search(rf"\b{name}\b", source.imported):
                return []
            path = source.imported
        keys = [key for key in self.by_key if key[1] == name]
        if len(keys) > 1:
            words = set(re.findall(r"\w+", path))
            keys = [key for key in keys if _module(key[0]) in words] or keys
        return keys if keys and all(self.scaled(key) for key in keys) else []

    def called(self, source: Source, start: int, end: int, offset: int) -> str:
        """A stretch of a file with calls in place of names; `offset` is where it will be."""
        parts, done, length = [], start, offset
        fixed = [(d.start, d.end) for d in source.definitions] if start == 0 else []
        fixed += source.statics if start == 0 else []
        for at, name in source.names(start, end):
            keys = self.meant(source, at, name)
            if not keys or any(a <= at < b for a, b in fixed):
                continue
            text = source.text[done:at] + f"{name}::get()"
            length += len(text)
            self.sites[source.file].append(_Site(keys, length - len(name) - 7, length))
            parts.append(text)
            done = at + len(name)
        return "".join([*parts, source.text[done:end]])

    def written(self, source: Source) -> str:
        """The whole file: what it had, with calls, and what is called at its end."""
        self.sites[source.file] = []
        text = self.called(source, 0, len(source.code), 0) + source.text[len(source.code) :]
        for each in source.definitions:
            key = (each.file, each.name)
            if self.by_key.get(key) is not each or not self.scaled(key):
                continue
            head = (
                f"\n#[allow(non_camel_case_types, dead_code, missing_docs)]\n{each.visibility}struct "
                f"{each.name} {{}}\n"
                f"#[allow(dead_code, missing_docs)]\nimpl {each.name} {{\n    #[inline(always)]\n"
                f"    pub fn get() -> {each.type} {{ "
            )
            head += f"crate::factors::value({self.listed.index(key)}, " if key in self.listed else "("
            text += head
            text += self.called(source, each.start, each.end, len(text)) + ") }\n}\n"
        return text


def _module(file: str) -> str:
    """The name by which paths call a file."""
    path = Path(file)
    return path.parent.name if path.stem == "mod" else path.stem


def copy_workspace(repository: Path, scratch: Path, names: Iterable[str]) -> None:
    """A copy of these files and folders in which the compiler does not warn of what a rewritten
    source lacks.
    """
    shutil.rmtree(scratch, ignore_errors=True)
    for name in names:
        to = scratch / name
        to.parent.mkdir(parents=True, exist_ok=True)
        if (repository / name).is_dir():
            shutil.copytree(repository / name, to)
        elif (repository / name).exists():
            shutil.copy(repository / name, to)
    # What the compiler merely warns of is expected here.
    manifest = scratch / "Cargo.toml"
    text = manifest.read_text(encoding="utf-8").replace('missing_docs = "warn"', 'missing_docs = "allow"')
    text = text.replace(
        "[workspace.lints.rust]", '[workspace.lints.rust]\nunused = { level = "allow", priority = -1 }'
    )
    manifest.write_text(text, encoding="utf-8")


def _open_doors(scratch: Path) -> None:
    doors = scratch / "crates/gelstereo-python/src/lib.rs"
    text = doors.read_text(encoding="utf-8").replace("#![forbid(unsafe_code)]", "")
    doors.write_text(text + _DOORS, encoding="utf-8")


def _errors(scratch: Path, target: Path) -> list[dict[str, object]]:
    """What the compiler refuses in the rewritten core."""
    words = ["cargo", "check", "--release", "-q", "-p", "gelstereo-core", "--features", "delaunay,serde"]
    words += ["--message-format=json"]
    ran = subprocess.run(
        [*words, "--target-dir", str(target)], cwd=scratch, capture_output=True, text=True, check=False
    )
    messages = [json.loads(line) for line in ran.stdout.splitlines() if line.startswith("{")]
    found = [m["message"] for m in messages if m.get("reason") == "compiler-message"]
    errors = [message for message in found if message["level"] == "error" and message["spans"]]
    if ran.returncode and not errors:
        raise RuntimeError(ran.stderr or ran.stdout[-2000:])
    return errors


def _blamed(rewriting: _Rewriting, errors: list[dict[str, object]]) -> dict[Key, str]:
    """Constants whose calls the compiler refuses, and why."""
    out: dict[Key, str] = {}
    for error in errors:
        spans: list[dict[str, object]] = list(error["spans"])  # type: ignore[call-overload]
        hit: set[Key] = set()
        for group in ([s for s in spans if s["is_primary"]], spans):
            for span in group:
                file = str(span["file_name"]).removeprefix(f"{_CORE.as_posix()}/")
                start, end = int(str(span["byte_start"])), int(str(span["byte_end"]))
                hit |= {
                    key
                    for site in rewriting.sites.get(file, [])
                    if site.start < end and start < site.end
                    for key in site.keys
                }
            if hit:
                break
        if not hit:
            raise RuntimeError(f"not of a constant: {error['rendered']}")
        borrowed = "dropped while borrowed" in str(error["message"])
        out.update(dict.fromkeys(hit, BORROWED if borrowed else FIXED))
    return out


def build(repository: Path, scratch: Path, target: Path, listed: list[Key]) -> dict[Key, str]:
    """Copy, rewrite until it compiles, and build the library; return what could not be rewritten, and why."""
    copy_workspace(repository, scratch, _COPIED)
    _open_doors(scratch)
    core = scratch / _CORE
    rewriting = _Rewriting(sources(repository / _CORE), listed)
    (core / "factors.rs").write_text(_FACTORS.replace("COUNT", str(max(len(listed), 1))), encoding="utf-8")
    while True:
        for file, source in rewriting.files.items():
            text = rewriting.written(source)
            if file == "lib.rs":
                text += "\n#[allow(missing_docs)]\npub mod factors;\n"
            (core / file).write_bytes(text.encode("latin-1"))
        errors = _errors(scratch, target)
        if not errors:
            break
        blamed = _blamed(rewriting, errors)
        print(f"{len(errors)} refusals: {len(blamed)} constants stay fixed", flush=True)
        rewriting.left.update(blamed)
        rewriting.settle()
    features = "pyo3/extension-module,pyo3/abi3-py310"
    words = ["cargo", "build", "--release", "-q", "-p", "gelstereo-python", "--lib", "--features", features]
    subprocess.run([*words, "--target-dir", str(target)], cwd=scratch, check=True)
    library = scratch / "python/gelstereo/_native.abi3.so"
    shutil.copy(target / "release/lib_native.so", library)
    return {key: reason for key, reason in rewriting.left.items() if key in listed}
