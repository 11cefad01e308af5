//! How frames leave the process: raw socket or in-process wire.
