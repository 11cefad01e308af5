//! The way from the browser to the machine: a network namespace, a cable that can be cut, relays of which one delays.

use std::{
    io::{self, Read, Write},
    net::{Shutdown, TcpListener, TcpStream},
    process::{Child, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc,
    },
    thread::{self, sleep},
    time::{Duration, Instant},
};

use super::{Result, own_path};

const NEAR: &str = "10.211.55.1";
pub(crate) const FAR: &str = "10.211.55.2";

/// A cable to a namespace, in which the port of the loopback interface leads to that of the machine.
pub(crate) struct Cable {
    pub(crate) namespace: String,
    near: String,
    relay: Option<Child>,
    delay: Arc<AtomicU64>,
}

impl Cable {
    pub(crate) fn lay(port: u16) -> Result<Self> {
        let id = std::process::id();
        let mut cable = Self {
            namespace: format!("servocrab-{id}"),
            near: format!("sc{id}"),
            relay: None,
            delay: Arc::default(),
        };
        let (namespace, near) = (cable.namespace.as_str(), cable.near.as_str());
        ip(&["netns", "add", namespace])?;
        ip(&[
            "link", "add", near, "type", "veth", "peer", "name", "far0", "netns", namespace,
        ])?;
        ip(&["addr", "add", &format!("{NEAR}/30"), "dev", near])?;
        ip(&["link", "set", near, "up"])?;
        ip(&["-n", namespace, "link", "set", "lo", "up"])?;
        ip(&[
            "-n",
            namespace,
            "addr",
            "add",
            &format!("{FAR}/30"),
            "dev",
            "far0",
        ])?;
        ip(&["-n", namespace, "link", "set", "far0", "up"])?;
        let listener = TcpListener::bind((NEAR, 0))?;
        let own = listener.local_addr()?.to_string();
        let delay = Arc::clone(&cable.delay);
        thread::spawn(move || pass_on(&listener, &format!("127.0.0.1:{port}"), &delay));
        let relay = cable
            .inside(&own_path()?.display().to_string())
            .args(["--relay", &format!("127.0.0.1:{port}"), &own])
            .spawn()?;
        cable.relay = Some(relay);
        Ok(cable)
    }

    /// A program in the namespace.
    pub(crate) fn inside(&self, program: &str) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.namespace, program]);
        command.stdin(Stdio::null());
        command
    }

    pub(crate) fn cut(&self) -> Result<()> {
        ip(&["link", "set", &self.near, "down"])
    }

    /// How late every message is.
    pub(crate) fn lateness(&self) -> Duration {
        Duration::from_millis(self.delay.load(Ordering::Relaxed))
    }

    /// From now on every message is this late, in both directions.
    pub(crate) fn delay(&self, time: Duration) {
        let time = u64::try_from(time.as_millis()).unwrap_or(u64::MAX);
        self.delay.store(time, Ordering::Relaxed);
    }

    pub(crate) fn mend(&self) -> Result<()> {
        self.delay(Duration::ZERO);
        ip(&["link", "set", &self.near, "up"])
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        if let Some(relay) = &mut self.relay {
            // It may be gone already.
            let _ = relay.kill();
            let _ = relay.wait();
        }
        // With it goes the cable.
        let _ = ip(&["netns", "del", &self.namespace]);
    }
}

fn ip(arguments: &[&str]) -> Result<()> {
    let done = Command::new("ip").args(arguments).output()?;
    if done.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&done.stderr);
    Err(format!(
        "ip {}: {} (network namespaces need root)",
        arguments.join(" "),
        said.trim()
    )
    .into())
}

/// Passes connections on, until the process ends.
pub(crate) fn relay(from: &str, to: &str) -> Result<()> {
    pass_on(&TcpListener::bind(from)?, to, &Arc::default());
    Ok(())
}

fn pass_on(listener: &TcpListener, to: &str, delay: &Arc<AtomicU64>) {
    for client in listener.incoming().flatten() {
        let Ok(server) = TcpStream::connect(to) else {
            continue;
        };
        let copies = client
            .try_clone()
            .and_then(|copy| Ok((copy, server.try_clone()?)));
        let Ok((client_copy, server_copy)) = copies else {
            continue;
        };
        for stream in [&client, &server] {
            // Without it, messages wait for each other.
            let _ = stream.set_nodelay(true);
        }
        one_way(client, server, Arc::clone(delay));
        one_way(server_copy, client_copy, Arc::clone(delay));
    }
}

/// Passes on what is read, each part when its time has come.
fn one_way(mut from: TcpStream, mut to: TcpStream, delay: Arc<AtomicU64>) {
    let (parts, due) = mpsc::channel::<(Instant, Vec<u8>)>();
    thread::spawn(move || {
        let mut buffer = [0; 16 * 1024];
        loop {
            match from.read(&mut buffer) {
                Ok(0) => return,
                Ok(length) => {
                    let late = Duration::from_millis(delay.load(Ordering::Relaxed));
                    if parts
                        .send((Instant::now() + late, buffer[..length].to_vec()))
                        .is_err()
                    {
                        return;
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(_) => return,
            }
        }
    });
    thread::spawn(move || {
        for (time, part) in due {
            sleep(time.saturating_duration_since(Instant::now()));
            if to.write_all(&part).is_err() {
                break;
            }
        }
        // The other end may be gone already.
        let _ = to.shutdown(Shutdown::Both);
    });
}
