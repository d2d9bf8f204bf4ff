"""The journal of a campaign: each shard's rows, kept until the whole is written, so that nothing that
was done is done again after an interruption.

    with Journal(folder, parameters, resume=True) as journal:
        journal.done            seeds of the shards that are there and whole
        journal.store(seed, compressed rows)
        journal.rows(seed)      CSV, in bytes
        journal.remove()        when the results are in their place

A shard is one file, written beside its place and renamed into it: SHA-256 of what follows, then the
rows, compressed. One that is damaged is as good as none. The parameters stand in campaign.json, which
is locked while a campaign runs.
"""

import fcntl
import hashlib
import json
import os
import shutil
import zlib
from pathlib import Path

DIGEST = 32


class JournalError(Exception):
    """It is of no use for this campaign; says why, and what to do."""


def _replace(path, data):
    temporary = path.with_suffix(".tmp")
    with open(temporary, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)


def _differences(told, found):
    """'runs is 100, was 200; ...'"""
    keys = sorted(set(told) | set(found))
    return "; ".join(f"{key} is {told.get(key)}, was {found.get(key)}"
                     for key in keys if told.get(key) != found.get(key))


class Journal:
    def __init__(self, folder, parameters, resume):
        self.folder = Path(folder)
        self.parameters = parameters
        self.damaged = []
        self.done = set()
        existed = self.folder.exists()
        if existed and not resume:
            raise JournalError(f"{self.folder} is left of an interrupted campaign: go on with --resume, "
                               "or remove it")
        self.folder.mkdir(parents=True, exist_ok=True)
        self._lock()
        try:
            self._check(existed)
        except JournalError:
            self.close()
            raise

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def _lock(self):
        self.lock = open(self.folder / "lock", "a+b")
        try:
            fcntl.flock(self.lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self.lock.close()
            raise JournalError(f"{self.folder} is in use: another campaign writes to the same file") from error

    def _check(self, existed):
        path = self.folder / "campaign.json"
        if not path.exists():
            if existed and any(self.folder.glob("*.rows")):
                raise JournalError(f"{path} is missing, so nobody knows whose the rows beside it are: "
                                   "remove the folder")
            _replace(path, json.dumps(self.parameters, indent=1).encode() + b"\n")
            return
        try:
            found = json.loads(path.read_text())
            if not isinstance(found, dict):
                raise ValueError("no object")
        except ValueError as error:
            raise JournalError(f"{path} is damaged ({error}): remove the folder") from error
        if found != self.parameters:
            raise JournalError(f"{self.folder} is of another campaign: "
                               f"{_differences(self.parameters, found)}; remove it, or name another file")
        self._read_shards()

    def _path(self, seed):
        return self.folder / f"{seed:020d}.rows"

    def _read_shards(self):
        for path in sorted(self.folder.glob("*.rows")):
            try:
                seed = int(path.stem)
                self._checked(path)
                self.done.add(seed)
            except (ValueError, OSError, zlib.error):
                self.damaged.append(path.name)
                path.unlink()

    @staticmethod
    def _checked(path):
        data = path.read_bytes()
        if hashlib.sha256(data[DIGEST:]).digest() != data[:DIGEST]:
            raise ValueError("damaged")
        return zlib.decompress(data[DIGEST:])

    def store(self, seed, compressed):
        _replace(self._path(seed), hashlib.sha256(compressed).digest() + compressed)
        self.done.add(seed)

    def rows(self, seed):
        try:
            return self._checked(self._path(seed))
        except (ValueError, OSError, zlib.error) as error:
            raise JournalError(f"{self._path(seed)} cannot be read any more ({error}): "
                               "--resume does its runs again") from error

    def remove(self):
        self.close()
        shutil.rmtree(self.folder)

    def close(self):
        self.lock.close()
