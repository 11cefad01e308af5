//! What `servocrab panel` prints.

use std::{
    io::{BufRead, BufReader},
    process::Child,
};

/// The address of the panel, and its token.
pub(crate) fn address(panel: &mut Child) -> (String, String) {
    let mut line = String::new();
    BufReader::new(panel.stdout.take().unwrap())
        .read_line(&mut line)
        .unwrap();
    let (address, token) = line
        .trim()
        .strip_prefix("http://")
        .unwrap()
        .split_once("/#token=")
        .unwrap();
    (address.to_owned(), token.to_owned())
}
