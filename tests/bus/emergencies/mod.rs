//! An emergency after every single datagram of a bring-up and of a move: each is delivered, and nothing else changes.
//!
//! A mailbox client that takes the next mail for its answer would end here: ethercrab's own panics. Nothing is sampled
//! but where two come at once.

mod bring_up;
mod idle;
mod line;
mod moving;
mod several;
mod stream;
