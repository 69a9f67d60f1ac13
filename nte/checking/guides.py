"""Are albedo and normals free of noise and antialiased, as denoisers that trust their guides want them?"""

from collections.abc import Iterator

from nte.checking.values import Finding
from nte.frames.clip import Clip
from nte.frames.frame import Frame


class GuideTally:
    def add(self, frame: Frame) -> None: ...

    def judge(self) -> Iterator[Finding]:
        return iter(())
