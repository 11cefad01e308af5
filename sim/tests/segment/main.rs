//! The simulated segment as a MainDevice sees it: frames that are composed by hand, and what comes back.

mod bring_up;
mod coe;
mod hostile;
mod master;
mod pdo_rules;
