//! Shows a running `servocrab` network to other programs of the same user and to a browser, and lets them stop its axes: HTTP/1.1 and
//! WebSockets on a Unix socket, and with a token on a port of the loopback interface. What the program grants they may change and move.
//!
//! `docs/attach.md` lists the requests. The server has a thread of its own, and so has its log. The bus thread does nothing for it.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use servocrab::{DriveConfig, Network, drives, link::Wire};
//! # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
//! # let wire = Wire::new(move |frame, now| segment.process(frame, now));
//! # let runtime = tempfile::tempdir()?;
//! # smol::block_on(async {
//! let drive = DriveConfig::new(drives::akd2g()).axis("x");
//! let net = Network::builder().link(wire).drive(0, drive).start().await?;
//! let attach = servocrab_attach::Attach::new("eth0");
//! # let attach = attach.directory(runtime.path().join("servocrab"));
//! let attached = servocrab_attach::serve(&net, attach)?;
//! println!("curl --unix-socket {} http://localhost/v1/axes", attached.socket().display());
//! # net.shutdown().await?;
//! # Ok(())
//! # })
//! # }
//! ```

/// The Rust block of the README, which `cargo test --doc` compiles.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
mod readme {}

mod client;
mod commands;
mod control;
mod forward;
mod gate;
mod grants;
mod journal;
mod line;
mod log;
mod metrics;
mod objects;
mod ordinary;
mod page;
mod program;
mod refusal;
mod requests;
mod server;
mod shown;
mod streams;

use std::{io, path::PathBuf, time::Duration};

pub use client::{Watch, WatchedSignal};
pub use grants::{AskedFor, Grant};
pub use program::{ClientError, Program};
pub use server::{Attached, Forwarded, forward, serve, socket_of};

/// How a network is shown.
#[derive(Debug, Clone)]
pub struct Attach {
    name: String,
    directory: Option<PathBuf>,
    port: Option<u16>,
    grants: Vec<Grant>,
    clients: usize,
    header_timeout: Duration,
}

impl Attach {
    /// On the socket of this network interface: `NAME.sock` in [`directory`](Self::directory). Up to 32 clients of each socket at a time,
    /// and five seconds for the header of a request.
    #[must_use]
    pub fn new(interface: &str) -> Self {
        Self {
            name: interface.to_owned(),
            directory: None,
            port: None,
            grants: Vec::new(),
            clients: 32,
            header_timeout: Duration::from_secs(5),
        }
    }

    /// Where the socket is; else in `$XDG_RUNTIME_DIR/servocrab`, or in `/run/servocrab` without that variable. A directory that is
    /// not there is made, for this user alone.
    #[must_use]
    pub fn directory(mut self, directory: impl Into<PathBuf>) -> Self {
        self.directory = Some(directory.into());
        self
    }

    /// On this port of the loopback interface as well, with the panel; 0 for one that is free. [`Attached::panel`] is its address, with a
    /// token that is made anew at each start. For another computer, forward the port by `ssh -L`.
    #[must_use]
    pub const fn loopback(mut self, port: u16) -> Self {
        self.port = Some(port);
        self
    }

    /// Lets clients do more than look and stop. None is granted by default.
    #[must_use]
    pub fn grant(mut self, grant: Grant) -> Self {
        self.grants.push(grant);
        self
    }

    /// How many clients may be connected at a time, to the Unix socket and to the port each; the connections of others are closed.
    #[must_use]
    pub const fn clients(mut self, clients: usize) -> Self {
        self.clients = clients;
        self
    }

    /// How long a client has for the header of each request; then its connection is closed.
    #[must_use]
    pub const fn header_timeout(mut self, timeout: Duration) -> Self {
        self.header_timeout = timeout;
        self
    }
}

/// Why a network cannot be shown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AttachError {
    /// The name is none of a file.
    #[error(
        "`{0}` cannot name a socket: use the name of the network interface (letters, digits, `-`, `_` and `.`)"
    )]
    Name(String),
    /// Others may change what is in the directory, or it is a link.
    #[error(
        "{} is no directory, does not belong to this user, or others may write to it: make it with mode 0700, or name another directory",
        .0.display()
    )]
    Directory(PathBuf),
    /// Another program shows a network on this socket.
    #[error("another program answers at {}: end it, or use another name", .0.display())]
    InUse(PathBuf),
    /// A grant that cannot be given.
    #[error("a grant cannot be given: {0}")]
    Grant(String),
    /// A thread of the server has inherited a real-time class, and cannot leave it: it could hold up the bus thread.
    #[error("a thread of the server cannot leave the real-time class of the calling thread: {0}")]
    Scheduling(io::Error),
    /// The operating system refuses.
    #[error("{}: {error}", .path.display())]
    Io {
        /// What was to be made or opened.
        path: PathBuf,
        /// Why it was not.
        error: io::Error,
    },
}
