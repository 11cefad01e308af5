//! The program `servocrab`, run as a user runs it. Its tests wait for processes most of their time, and do so beside each other.
#![allow(missing_docs)]

mod bundle;
mod capture;
mod commands;
mod guide;
mod live;
#[path = "../../../tests/common/namespace.rs"]
mod namespace;
mod panel;
#[path = "../../../tests/common/python.rs"]
mod python;
mod running;
