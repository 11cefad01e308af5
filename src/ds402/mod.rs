//! The DS402 device profile: words, states, transitions, modes, option codes, error codes (pure).
