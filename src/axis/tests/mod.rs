//! An axis core against a drive that is played word by word.

mod modes;
mod played;
mod power;
mod resetting;
mod stops;
