//! The sockets, their thread, and who is let in: this user and root, and over TCP who has the token; so many at a time.

use std::{
    fmt, fs,
    io::{self, ErrorKind},
    net::{Ipv4Addr, SocketAddr, TcpListener as StdTcpListener},
    os::unix::{
        fs::{DirBuilderExt, FileTypeExt as _, MetadataExt, PermissionsExt},
        net::{UnixListener as StdListener, UnixStream as StdStream},
    },
    path::{Path, PathBuf},
    pin::pin,
    sync::Arc,
    time::{Duration, Instant},
};

use axum::{Extension, Router, middleware::from_fn_with_state};
use hyper::server::conn::http1;
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use rustix::process::geteuid;
use servocrab::Network;
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::{TcpListener, TcpStream, UnixListener, UnixStream},
    runtime,
    sync::{Mutex, OwnedSemaphorePermit, Semaphore, mpsc, oneshot},
    task::yield_now,
    time::{sleep, timeout},
};

use crate::{
    Attach, AttachError,
    gate::{self, Gate, Token},
    grants::{AskedFor, Granted},
    journal::Journal,
    log::{Log, Subscriber, unlogged},
    ordinary::{OrdinaryThread, ThreadEnd},
    page, requests,
    shown::Shown,
};

/// What clients have asked for and the program has not taken.
const QUESTIONS: usize = 16;
/// The header of a request, and what is read of a body before it is refused, in bytes.
const BUFFER: usize = 16 * 1024;
/// How long a connection takes requests, and how long it may take for the last of them after that: a client that never reads does not keep
/// its place.
const CONNECTION: Duration = Duration::from_secs(60);
/// After an error of the socket, such as no free file descriptor.
const PAUSE: Duration = Duration::from_millis(100);
/// How long the end of the server waits for its threads.
const END: Duration = Duration::from_secs(1);

/// A network that is shown, until this is dropped or the program ends. Neither this nor its end has an effect on any axis, but for the
/// jogs that clients hold: they end. The end takes a second at most, also where the log is behind.
#[derive(Debug)]
pub struct Attached {
    socket: PathBuf,
    server: Server,
    asked: Mutex<mpsc::Receiver<AskedFor>>,
}

impl Attached {
    /// Where the Unix socket is.
    #[must_use]
    pub fn socket(&self) -> &Path {
        &self.socket
    }

    /// The address of the panel, with the token of this start; none without [`Attach::loopback`]. Who has it may do what is granted.
    #[must_use]
    pub fn panel(&self) -> Option<&str> {
        self.server.panel.as_deref()
    }

    /// The next axis that a client asks for, whose mode the program holds; `None` once the server has ended. Who agrees drops its lease.
    /// Sixteen questions are kept.
    pub async fn asked(&self) -> Option<AskedFor> {
        self.asked.lock().await.recv().await
    }
}

impl Drop for Attached {
    fn drop(&mut self) {
        self.server.end();
        // Where it is gone already there is nothing to be removed.
        let _ = fs::remove_file(&self.socket);
    }
}

/// A port on which the network of another program is shown, until this is dropped.
#[derive(Debug)]
pub struct Forwarded(Server);

impl Forwarded {
    /// The address of the panel, with the token of this start.
    #[must_use]
    pub fn panel(&self) -> &str {
        self.0.panel.as_deref().unwrap_or_default()
    }
}

/// The thread that serves, and the one that writes the log, until this is dropped.
#[derive(Debug)]
struct Server {
    panel: Option<String>,
    end: Option<oneshot::Sender<()>>,
    thread: Option<OrdinaryThread>,
    log: Log,
    writer: Option<OrdinaryThread>,
}

impl Server {
    /// Waits for the threads for a second at most: what follows may be the stop of the axes.
    fn end(&mut self) {
        let until = Instant::now() + END;
        // It is dropped, which the thread hears.
        self.end.take();
        match self.thread.take().map(|thread| thread.end(until)) {
            None | Some(ThreadEnd::Over) => {}
            Some(ThreadEnd::Panicked) => self.log.error(format_args!("the thread has panicked")),
            Some(ThreadEnd::StillAtWork) => self
                .log
                .error(format_args!("the thread has not ended within {END:?}")),
        }
        self.log.close();
        if let Some(writer) = self.writer.take() {
            // Where a subscriber blocks, the thread writes the rest when it can, and ends.
            let _ = writer.end(until);
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.end();
    }
}

/// Shows this network, from now until the result is dropped.
///
/// # Errors
/// [`AttachError`] where a socket cannot be made: its name, its directory, another program that answers there, the operating system.
/// [`AttachError::Grant`] for a grant of an axis that is not declared. [`AttachError::Scheduling`] where the server's thread would keep the
/// real-time class of the calling one.
pub fn serve(net: &Network, attach: Attach) -> Result<Attached, AttachError> {
    let granted = Granted::of(net, &attach.grants)?;
    let (asks, asked) = mpsc::channel(QUESTIONS);
    let log = Log::default();
    let this_start = Token::new().map_err(|error| AttachError::Io {
        path: PathBuf::from(&attach.name),
        error,
    })?;
    let shown = Shown {
        view: net.view(),
        transfers: Arc::new(Semaphore::new(1)),
        granted: Arc::new(granted),
        asks,
        streams: Arc::default(),
        dictionaries: Arc::default(),
        led: Arc::default(),
        journal: Journal::default(),
        log: log.clone(),
    };
    let router = requests::router(shown, this_start.value());
    let socket = socket(&attach)?;
    let at_socket = |error| AttachError::Io {
        path: socket.clone(),
        error,
    };
    let listener = StdListener::bind(&socket).map_err(at_socket)?;
    let served = fs::set_permissions(&socket, fs::Permissions::from_mode(0o600))
        .and_then(|()| listener.set_nonblocking(true))
        .map_err(at_socket)
        .and_then(|()| start(router, Some(listener), attach, log));
    match served {
        Ok(server) => {
            let shown_at = socket.display();
            server
                .log
                .info(format_args!("the network is shown at {shown_at}"));
            Ok(Attached {
                socket,
                server,
                asked: Mutex::new(asked),
            })
        }
        Err(error) => {
            // Where it is gone already there is nothing to be removed.
            let _ = fs::remove_file(&socket);
            Err(error)
        }
    }
}

/// Shows, on a port of the loopback interface, the network that another program shows on this Unix socket: with a token of its own. For
/// the panel of a program that opens no port itself. Once that program has ended, the next one that shows a network there refuses what comes
/// this way.
///
/// # Errors
/// [`AttachError::Io`] where nobody answers at the socket, or the port cannot be had.
pub fn forward(socket: &Path, port: u16) -> Result<Forwarded, AttachError> {
    StdStream::connect(socket).map_err(|error| AttachError::Io {
        path: socket.to_owned(),
        error,
    })?;
    let attach = Attach::new("").loopback(port);
    let log = Log::default();
    let router = crate::forward::router(socket, log.clone());
    start(router, None, attach, log).map(Forwarded)
}

/// Where an attached program with the default directory shows the network of this interface.
#[must_use]
pub fn socket_of(interface: &str) -> PathBuf {
    directory().join(format!("{interface}.sock"))
}

/// The threads, with what is listened on.
fn start(
    router: Router,
    unix: Option<StdListener>,
    attach: Attach,
    log: Log,
) -> Result<Server, AttachError> {
    let Attach {
        name,
        port,
        clients,
        header_timeout,
        ..
    } = attach;
    let failed = |error| AttachError::Io {
        path: match port {
            Some(port) => PathBuf::from(format!("127.0.0.1:{port}")),
            None => PathBuf::from(&name),
        },
        error,
    };
    let runtime = runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(failed)?;
    // Each socket has places of its own: anybody on this computer can connect to the port, and take those there without the token.
    let limits = || Limits {
        places: Arc::new(Semaphore::new(clients)),
        clients,
        header: header_timeout,
        log: log.clone(),
    };
    let tcp = port.map(tcp_listener).transpose().map_err(failed)?;
    let mut panel = None;
    {
        let _entered = runtime.enter();
        if let Some(listener) = tcp {
            let token = Token::new().map_err(failed)?;
            let address = listener.local_addr().map_err(failed)?;
            let listener = TcpListener::from_std(listener).map_err(failed)?;
            panel = Some(format!("http://{address}/#token={}", token.text()));
            let port = address.port();
            let gate = Gate {
                token,
                port,
                log: log.clone(),
            };
            let gate = from_fn_with_state(gate, gate::check);
            let router = router.clone().merge(page::router()).layer(gate);
            runtime.spawn(accept(listener, router, limits()));
        }
        if let Some(listener) = unix {
            let listener = UnixListener::from_std(listener).map_err(failed)?;
            runtime.spawn(accept(listener, router, limits()));
        }
    }
    let (end, ended) = oneshot::channel::<()>();
    let (written, subscriber) = (log.clone(), Subscriber::current());
    let writer = OrdinaryThread::start("attach-log", failed, move || {
        written.write_all(&subscriber);
    })?;
    let mut server = Server {
        panel,
        end: Some(end),
        thread: None,
        log,
        writer: Some(writer),
    };
    let thread = OrdinaryThread::start("servocrab-attach", failed, move || {
        unlogged(|| {
            // Nothing is ever sent. The connections end with the runtime.
            let _ = runtime.block_on(ended);
            drop(runtime);
        });
    })?;
    server.thread = Some(thread);
    Ok(server)
}

fn tcp_listener(port: u16) -> io::Result<StdTcpListener> {
    let listener = StdTcpListener::bind((Ipv4Addr::LOCALHOST, port))?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Where the sockets are.
fn directory() -> PathBuf {
    let runtime = std::env::var_os("XDG_RUNTIME_DIR").filter(|path| !path.is_empty());
    PathBuf::from(runtime.unwrap_or_else(|| "/run".into())).join("servocrab")
}

/// Removes what is left of a program that was killed, and nothing else.
fn remove_socket(socket: &Path) -> io::Result<()> {
    if fs::symlink_metadata(socket)?.file_type().is_socket() {
        return fs::remove_file(socket);
    }
    let text = "what is there is no socket, and is left as it is: name another";
    Err(io::Error::new(ErrorKind::AlreadyExists, text))
}

/// Where the socket is to be, with nothing in its place.
fn socket(attach: &Attach) -> Result<PathBuf, AttachError> {
    let name = attach.name.as_str();
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
    if name.is_empty() || name.starts_with('.') || !name.bytes().all(is_plain) {
        return Err(AttachError::Name(name.to_owned()));
    }
    let directory = attach.directory.clone().unwrap_or_else(directory);
    let at_directory = |error| AttachError::Io {
        path: directory.clone(),
        error,
    };
    match fs::DirBuilder::new().mode(0o700).create(&directory) {
        Err(error) if error.kind() != ErrorKind::AlreadyExists => return Err(at_directory(error)),
        _ => {}
    }
    // Of a link somebody else may say where it leads.
    let found = fs::symlink_metadata(&directory).map_err(at_directory)?;
    if !found.is_dir() || found.uid() != geteuid().as_raw() || found.mode() & 0o022 != 0 {
        return Err(AttachError::Directory(directory));
    }
    let socket = directory.join(format!("{name}.sock"));
    match StdStream::connect(&socket) {
        Ok(_) => Err(AttachError::InUse(socket)),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(socket),
        // Left over from a program that was killed.
        Err(error) if error.kind() == ErrorKind::ConnectionRefused => {
            match remove_socket(&socket) {
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

/// What holds for all clients together.
#[derive(Clone)]
struct Limits {
    places: Arc<Semaphore>,
    clients: usize,
    header: Duration,
    log: Log,
}

/// Kept by a client for as long as it is connected.
pub(crate) type Place = Arc<OwnedSemaphorePermit>;

/// Where clients come in.
trait Listener: Send + 'static {
    type Stream: AsyncRead + AsyncWrite + Unpin + Send + 'static;

    /// The next connection, and who it is; `None` of who is not let in.
    fn next(
        &self,
        log: &Log,
    ) -> impl Future<Output = io::Result<Option<(Self::Stream, Client)>>> + Send;
}

impl Listener for UnixListener {
    type Stream = UnixStream;

    async fn next(&self, log: &Log) -> io::Result<Option<(UnixStream, Client)>> {
        let (stream, _) = self.accept().await?;
        let peer = match stream.peer_cred() {
            Ok(peer) => peer,
            Err(error) => {
                log.warn(format_args!("refused: it is not known who it is: {error}"));
                return Ok(None);
            }
        };
        if !is_allowed(peer.uid()) {
            let user = peer.uid();
            log.warn(format_args!("refused: user {user} is not the program's"));
            return Ok(None);
        }
        let client = Client::Local {
            user: peer.uid(),
            process: peer.pid(),
        };
        Ok(Some((stream, client)))
    }
}

impl Listener for TcpListener {
    type Stream = TcpStream;

    async fn next(&self, _: &Log) -> io::Result<Option<(TcpStream, Client)>> {
        let (stream, address) = self.accept().await?;
        // Small messages are not to wait for each other. Where that cannot be set they do.
        let _ = stream.set_nodelay(true);
        Ok(Some((stream, Client::Tcp(address))))
    }
}

async fn accept<L: Listener + Sync>(listener: L, router: Router, limits: Limits) {
    loop {
        let (stream, client) = match listener.next(&limits.log).await {
            Ok(Some(connected)) => connected,
            Ok(None) => continue,
            Err(error) => {
                limits
                    .log
                    .warn(format_args!("no client can be let in: {error}"));
                sleep(PAUSE).await;
                continue;
            }
        };
        if limits.places.available_permits() == 0 {
            // Clients that have left give their places back first: many can come in before their tasks run.
            yield_now().await;
        }
        let Ok(place) = Arc::clone(&limits.places).try_acquire_owned() else {
            let clients = limits.clients;
            limits
                .log
                .debug(format_args!("refused: {clients} clients are connected"));
            continue;
        };
        limits.log.debug(format_args!("connected: {client}"));
        let place: Place = Arc::new(place);
        let router = router
            .clone()
            .layer(Extension(client))
            .layer(Extension(Arc::clone(&place)));
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(limits.header)
            .max_buf_size(BUFFER)
            .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router))
            .with_upgrades();
        tokio::spawn(async move {
            let mut connection = pin!(connection);
            // A client that breaks the protocol has nobody to be reported to. A WebSocket goes on after it.
            if timeout(CONNECTION, connection.as_mut()).await.is_err() {
                // A request that is under way is answered: it may be a stop.
                connection.as_mut().graceful_shutdown();
                let _ = timeout(CONNECTION, connection).await;
            }
            drop(place);
        });
    }
}

/// Who is at the other end.
#[derive(Debug, Clone)]
pub(crate) enum Client {
    /// The user and the process, as the kernel knows them.
    Local { user: u32, process: Option<i32> },
    /// Who has the token.
    Tcp(SocketAddr),
}

impl fmt::Display for Client {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Local {
                user,
                process: Some(process),
            } => write!(f, "user {user}, process {process}"),
            Self::Local {
                user,
                process: None,
            } => write!(f, "user {user}"),
            Self::Tcp(address) => write!(f, "{address} with the token"),
        }
    }
}

fn is_allowed(user: u32) -> bool {
    user == 0 || user == geteuid().as_raw()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_root_and_the_user_of_the_program_are_let_in() {
        let own = geteuid().as_raw();
        assert!(is_allowed(own) && is_allowed(0));
        assert!(!is_allowed(own + 1));
    }
}
