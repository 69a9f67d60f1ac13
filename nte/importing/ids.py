"""Object ids of any kind, renumbered where float32 would not tell them apart."""

import numpy as np
import numpy.typing as npt

from nte.errors import NteError
from nte.frames.clip import Pixels

UNNAMED = 2.0**24 - 1  # the instance of a surface whose stored id is 0, since 0 means a miss
_FIRST_NEW = 2**23  # whole numbers below this stay as they are
_HALF_END = 2048  # half floats hold every whole number below this, and every second one above
_ROOM = int(UNNAMED) - _FIRST_NEW


class Ids:
    """The ids of a sequence: small whole numbers stay, all others get new numbers in the order in which they come.

    The others are 32-bit numbers that float32 would round together, negative numbers, and hashes (Cryptomatte).
    """

    def __init__(self) -> None:
        self.renumbered: dict[float, int] = {}
        self.averaged = 0  # pixels with fractions beside whole ids
        self.rounded = 0  # pixels with ids that half floats have rounded, perhaps to those of others

    def keep(self, ids: npt.NDArray[np.generic], half: bool = False) -> Pixels:
        """Convert stored ids of any type to the sequence's float32 numbers, same shape; non-finite ones become 0.

        half: the file has them in half floats. Raises NteError if more than eight million ids need a new number.
        """
        values = np.nan_to_num(ids.astype(np.float64), nan=0, posinf=0, neginf=0)
        self.rounded += int((np.abs(values) >= _HALF_END).sum()) if half else 0
        odd = (values < 0) | (values >= _FIRST_NEW) | (values != np.floor(values))
        fractions = int((values != np.floor(values)).sum())
        if fractions < int(((values > 0) & ~odd).sum()):  # most ids are whole, so these are no hashes
            self.averaged += fractions
        unique, place = np.unique(values[odd], return_inverse=True)
        for value in unique.tolist():
            self.renumbered.setdefault(value, _FIRST_NEW + len(self.renumbered))
        if len(self.renumbered) >= _ROOM:
            raise NteError(f"'instance' has more than {_ROOM} ids that are no small whole numbers: expected ids")
        new = np.array([self.renumbered[value] for value in unique.tolist()], np.float64)
        values[odd] = new[place] if unique.size else values[odd]
        return values.astype(np.float32)
