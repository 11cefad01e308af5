//! What is known of particular drives, as data.
