//! Every behaviour that the source documents of the drives describe, one row each: a test of the simulated drive, a test
//! of the library, and for each of them a mutation that turns it red. `ROWS.md` shows the tables; `cargo xtask mutants`
//! proves the mutations.
#![allow(missing_docs)]

#[path = "../common/mod.rs"]
mod common;

#[macro_use]
mod table;
mod akd2g_cw;
mod akd2g_help;
mod akd2g_pp;
mod ax2000;
mod bench;
mod page;
mod pp2010;
mod sigma7;
mod wire;

/// The documents, in the order of the page.
const DOCUMENTS: &[&table::Document] = &[
    &akd2g_pp::DOCUMENT,
    &akd2g_cw::DOCUMENT,
    &akd2g_help::DOCUMENT,
    &pp2010::DOCUMENT,
    &ax2000::DOCUMENT,
    &sigma7::DOCUMENT,
];
