//! The socket, its thread, and who is let in: this user and root, so many at a time.

use std::{
    fs,
    io::{self, ErrorKind},
    os::unix::{
        fs::{DirBuilderExt, MetadataExt, PermissionsExt},
        net::{UnixListener as StdListener, UnixStream as StdStream},
    },
    path::{Path, PathBuf},
    sync::{Arc, mpsc},
    thread::{self, JoinHandle},
    time::Duration,
};

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use rustix::process::geteuid;
use servocrab::bus::Network;
use tokio::{
    net::{UnixListener, UnixStream},
    runtime,
    sync::{Semaphore, oneshot},
    time::{sleep, timeout},
};

use crate::{Attach, AttachError, ordinary, requests};

const LOG: &str = "servocrab::attach";
/// The header of a request, and what is read of a body before it is refused, in bytes.
const BUFFER: usize = 16 * 1024;
/// How long a connection lasts, so that a client that never reads does not keep its place.
const CONNECTION: Duration = Duration::from_secs(60);
/// After an error of the socket, such as no free file descriptor.
const PAUSE: Duration = Duration::from_millis(100);

/// A network that is shown, until this is dropped or the program ends. Neither this nor its end has an effect on any axis.
#[derive(Debug)]
pub struct Attached {
    socket: PathBuf,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Attached {
    /// Where the socket is.
    #[must_use]
    pub fn socket(&self) -> &Path {
        &self.socket
    }
}

impl Drop for Attached {
    fn drop(&mut self) {
        // It is dropped, which the thread hears.
        self.end.take();
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!(target: LOG, "the thread has panicked");
        }
        // Where it is gone already there is nothing to be removed.
        let _ = fs::remove_file(&self.socket);
    }
}

/// Shows this network, from now until the result is dropped.
///
/// # Errors
/// [`AttachError`] where the socket cannot be made: its name, its directory, another program that answers there, the operating system.
/// [`AttachError::Scheduling`] where the server's thread would keep the real-time class of the calling one.
pub fn serve(net: &Network, attach: Attach) -> Result<Attached, AttachError> {
    let socket = socket(&attach)?;
    let at_socket = |error| AttachError::Io {
        path: socket.clone(),
        error,
    };
    let listener = StdListener::bind(&socket).map_err(at_socket)?;
    fs::set_permissions(&socket, fs::Permissions::from_mode(0o600)).map_err(at_socket)?;
    listener.set_nonblocking(true).map_err(at_socket)?;
    let runtime = runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(at_socket)?;
    let listener = {
        let _entered = runtime.enter();
        UnixListener::from_std(listener).map_err(at_socket)?
    };
    let router = requests::router(net.view());
    let (end, ended) = oneshot::channel::<()>();
    let (ordinary, is_ordinary) = mpsc::sync_channel(1);
    let thread = thread::Builder::new()
        .name("servocrab-attach".to_owned())
        .spawn(move || {
            let scheduled = ordinary::schedule();
            let goes_on = scheduled.is_ok();
            // The program waits for it.
            let _ = ordinary.send(scheduled);
            if !goes_on {
                return;
            }
            runtime.block_on(async {
                tokio::spawn(accept(listener, router, attach));
                // Nothing is ever sent.
                let _ = ended.await;
            });
            // The connections end with the runtime.
        })
        .map_err(at_socket)?;
    if let Ok(Err(error)) = is_ordinary.recv() {
        // Where it is gone already there is nothing to be removed.
        let _ = fs::remove_file(&socket);
        return Err(AttachError::Scheduling(error));
    }
    tracing::info!(target: LOG, "the network is shown at {}", socket.display());
    Ok(Attached {
        socket,
        end: Some(end),
        thread: Some(thread),
    })
}

/// Where the socket is to be, with nothing in its place.
fn socket(attach: &Attach) -> Result<PathBuf, AttachError> {
    let name = attach.name.as_str();
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
    if name.is_empty() || name.starts_with('.') || !name.bytes().all(is_plain) {
        return Err(AttachError::Name(name.to_owned()));
    }
    let directory = attach.directory.clone().unwrap_or_else(|| {
        let runtime = std::env::var_os("XDG_RUNTIME_DIR").filter(|path| !path.is_empty());
        PathBuf::from(runtime.unwrap_or_else(|| "/run".into())).join("servocrab")
    });
    let at_directory = |error| AttachError::Io {
        path: directory.clone(),
        error,
    };
    match fs::DirBuilder::new().mode(0o700).create(&directory) {
        Err(error) if error.kind() != ErrorKind::AlreadyExists => return Err(at_directory(error)),
        _ => {}
    }
    let found = fs::metadata(&directory).map_err(at_directory)?;
    if found.uid() != geteuid().as_raw() || found.mode() & 0o022 != 0 {
        return Err(AttachError::Directory(directory));
    }
    let socket = directory.join(format!("{name}.sock"));
    match StdStream::connect(&socket) {
        Ok(_) => Err(AttachError::InUse(socket)),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(socket),
        // Left over from a program that was killed.
        Err(error) if error.kind() == ErrorKind::ConnectionRefused => {
            match fs::remove_file(&socket) {
                Ok(()) => Ok(socket),
                Err(error) => Err(AttachError::Io {
                    path: socket,
                    error,
                }),
            }
        }
        Err(error) => Err(AttachError::Io {
            path: socket,
            error,
        }),
    }
}

async fn accept(listener: UnixListener, router: Router, attach: Attach) {
    let places = Arc::new(Semaphore::new(attach.clients));
    loop {
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!(target: LOG, "no client can be let in: {error}");
                sleep(PAUSE).await;
                continue;
            }
        };
        let client = match Client::of(&stream) {
            Ok(client) if client.is_allowed() => client,
            Ok(client) => {
                tracing::warn!(target: LOG, "refused: user {} is not the program's", client.user);
                continue;
            }
            Err(error) => {
                tracing::warn!(target: LOG, "refused: it is not known who it is: {error}");
                continue;
            }
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
            tracing::debug!(target: LOG, "refused: {} clients are connected", attach.clients);
            continue;
        };
        tracing::debug!(target: LOG, "connected: user {}, process {:?}", client.user, client.process);
        let service = TowerToHyperService::new(router.clone().layer(Extension(client)));
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(attach.header_timeout)
            .max_buf_size(BUFFER)
            .serve_connection(TokioIo::new(stream), service);
        tokio::spawn(async move {
            // A client that breaks the protocol or stays too long has nobody to be reported to.
            let _ = timeout(CONNECTION, connection).await;
            drop(place);
        });
    }
}

/// The user and the process at the other end, as the kernel knows them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Client {
    pub(crate) user: u32,
    pub(crate) process: Option<i32>,
}

impl Client {
    fn of(stream: &UnixStream) -> io::Result<Self> {
        let peer = stream.peer_cred()?;
        Ok(Self {
            user: peer.uid(),
            process: peer.pid(),
        })
    }

    fn is_allowed(self) -> bool {
        self.user == 0 || self.user == geteuid().as_raw()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_root_and_the_user_of_the_program_are_let_in() {
        let own = geteuid().as_raw();
        let of = |user| Client {
            user,
            process: None,
        };
        assert!(of(own).is_allowed() && of(0).is_allowed());
        assert!(!of(own + 1).is_allowed());
    }
}
