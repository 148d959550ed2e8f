"""The records of a ZIP: their layouts and the few constants that matter to a reader of stored members.

PKWARE APPNOTE 6.3.10, sections 4.3.7, 4.3.12, 4.3.14 to 4.3.16, 4.4.4 and 4.5.3. Each layout starts with the
record's four-byte signature.
"""

from __future__ import annotations

import struct

LOCAL = struct.Struct("<4s5H3I2H")
CENTRAL = struct.Struct("<4s6H3I5H2I")
END = struct.Struct("<4s4H2IH")
END64 = struct.Struct("<4sQ2H2I4Q")
LOCATOR = struct.Struct("<4sIQI")

FULL16, FULL32 = 0xFFFF, 0xFFFFFFFF
"""In place of a value that is in the ZIP64 record instead."""
ENCRYPTED = 0x0001 | 0x0040 | 0x2000
"""Flags of encrypted data, strong encryption and a masked header."""
DESCRIPTOR = 0x0008
"""Flag: sizes and CRC follow the data."""
EXTRA_ZIP64 = 0x0001
"""Id of the ZIP64 record among the extra fields."""
