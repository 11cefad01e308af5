//! An axis core against a drive that is played word by word.

mod changing;
mod loss;
mod modes;
mod played;
mod power;
mod resetting;
mod resting;
mod standing;
mod stops;
