//! The simulated segment as a MainDevice sees it: frames that are composed by hand, and what comes back.

mod bring_up;
mod clock;
mod coe;
mod complete_access;
mod datagrams;
mod dictionary;
mod drive_events;
mod eeprom;
mod hostile;
mod identification;
mod information;
mod master;
mod modes;
mod pdo_rules;
mod personalities;
mod ports;
mod switches;
