//! What `servocrab panel` prints, and answers.

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    process::Child,
    time::Duration,
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

/// The whole answer to a request with this token.
pub(crate) fn get(address: &str, token: &str, path: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(10)))
        .unwrap();
    write!(
        stream,
        "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\nAuthorization: Bearer {token}\r\n\r\n"
    )
    .unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}
