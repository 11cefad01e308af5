//! Profile Position: set-points, the handshake of bits 4 and 12, halt, outcomes.
