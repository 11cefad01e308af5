//! A raw socket (AF_PACKET, Linux) on one network interface.
#![allow(unsafe_code)]

use std::{
    ffi::CString,
    io,
    os::fd::{AsRawFd, FromRawFd, OwnedFd},
    task::Waker,
    time::Duration,
};

use rustix::net::{SendFlags, send};

use super::{
    ETHERTYPE, Link, SHORTEST_FRAME, others,
    ring::Ring,
    waiting::{self, Sleeper},
};

/// Why a raw socket could not be opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RawSocketError {
    /// The process may not open raw sockets.
    #[error(
        "no permission to open a raw socket: run as root, or give the program the capability \
         (`setcap cap_net_raw+ep <program>`; where it asks for real time too, all in one: \
         `setcap cap_net_raw,cap_sys_nice,cap_ipc_lock+ep <program>`, since those that are not named are taken away)"
    )]
    NoPermission,
    /// There is no interface of this name.
    #[error("there is no network interface `{0}`")]
    NoInterface(String),
    /// The interface is there, but down.
    #[error("the network interface `{0}` is down: bring it up (`ip link set {0} up`)")]
    InterfaceDown(String),
    /// The interface does not take EtherCAT's longest frames.
    #[error(
        "the network interface `{interface}` takes frames of up to {mtu} bytes (MTU), and EtherCAT's have up to 1500: \
         `ip link set {interface} mtu 1500`"
    )]
    ShortFrames {
        /// The interface's name.
        interface: String,
        /// The longest payload that it takes.
        mtu: i32,
    },
    /// Another program has EtherCAT on the interface, or another network of this one.
    #[error(
        "the network interface `{0}` is in use: another program has a socket for EtherCAT on it, or another network of this one that \
         may be on its way to its end. Two masters on one line reset each other's devices: end that one first (`ss --packet \
         --processes`, as root, says which program it is)"
    )]
    InUse(String),
    /// Any other refusal of the operating system.
    #[error("cannot {step} on network interface `{interface}`: {source}")]
    Os {
        /// What was attempted.
        step: &'static str,
        /// The interface's name.
        interface: String,
        /// What the operating system says.
        source: io::Error,
    },
}

/// A raw socket that sends and receives EtherCAT frames on one network interface.
///
/// Needs the capability `CAP_NET_RAW`. One master at a time: it does not open while another socket for EtherCAT is bound to the
/// interface, this process's own or that of any program. Captures (Wireshark, tcpdump) disturb nothing.
///
/// ```no_run
/// use servocrab::link::RawSocket;
/// let link = RawSocket::open("eth0")?;
/// # Ok::<(), servocrab::link::RawSocketError>(())
/// ```
pub struct RawSocket {
    socket: OwnedFd,
    ring: Ring,
    sleeper: Sleeper,
    padded: [u8; SHORTEST_FRAME],
}

impl RawSocket {
    /// Opens a socket on the interface of this name.
    ///
    /// # Errors
    /// No permission, no such interface, the interface is down, another master uses it, or what else the operating system refuses.
    pub fn open(interface: &str) -> Result<Self, RawSocketError> {
        let os = |step| {
            let interface = interface.to_owned();
            move |source| RawSocketError::Os {
                step,
                interface,
                source,
            }
        };
        let name = CString::new(interface)
            .map_err(|_| RawSocketError::NoInterface(interface.to_owned()))?;
        // SAFETY: the name is a string with its end mark and is valid until the call is over.
        let index = unsafe { libc::if_nametoindex(name.as_ptr()) };
        let index = libc::c_int::try_from(index).unwrap_or(0);
        if index == 0 {
            return Err(RawSocketError::NoInterface(interface.to_owned()));
        }
        let socket = open_socket().map_err(|error| match error.raw_os_error() {
            Some(libc::EPERM | libc::EACCES) => RawSocketError::NoPermission,
            _ => os("open a raw socket")(error),
        })?;
        if !is_up(&socket, &name).map_err(os("read the flags"))? {
            return Err(RawSocketError::InterfaceDown(interface.to_owned()));
        }
        let mtu = mtu(&socket, &name).map_err(os("read the MTU"))?;
        if mtu < LONGEST_PAYLOAD {
            let interface = interface.to_owned();
            return Err(RawSocketError::ShortFrames { interface, mtu });
        }
        // Without this the socket reads its own frames back before the segment's answer.
        set_option(&socket, PACKET_IGNORE_OUTGOING, &1i32).map_err(os("ignore outgoing frames"))?;
        // Answers carry the destination they were sent with, which is the broadcast address: but a switch or a
        // virtual interface may change it.
        let membership = libc::packet_mreq {
            mr_ifindex: index,
            mr_type: PACKET_MR_PROMISC,
            mr_alen: 0,
            mr_address: [0; 8],
        };
        set_option(&socket, libc::PACKET_ADD_MEMBERSHIP, &membership)
            .map_err(os("receive all frames"))?;
        let ring = Ring::new(&socket).map_err(os("make a ring for received frames"))?;
        bind(&socket, index).map_err(os("bind"))?;
        // Before anything is sent. Not before binding: of two that begin together none would see the other.
        if others::is_taken(&socket, index).map_err(os("look who else uses it"))? {
            return Err(RawSocketError::InUse(interface.to_owned()));
        }
        Ok(Self {
            ring,
            sleeper: Sleeper::new(&socket).map_err(os("prepare to sleep"))?,
            socket,
            padded: [0; SHORTEST_FRAME],
        })
    }
}

/// `PACKET_IGNORE_OUTGOING` of linux/if_packet.h (since Linux 4.20).
const PACKET_IGNORE_OUTGOING: libc::c_int = 23;
/// `PACKET_MR_PROMISC` of linux/if_packet.h, in the width of the structure's field.
const PACKET_MR_PROMISC: libc::c_ushort = 1;

fn open_socket() -> io::Result<OwnedFd> {
    // SAFETY: socket takes no pointers; its result is checked before it is used as a descriptor. Protocol 0 receives
    // nothing until the socket is bound to its interface.
    let fd = unsafe {
        libc::socket(
            libc::AF_PACKET,
            libc::SOCK_RAW | libc::SOCK_NONBLOCK | libc::SOCK_CLOEXEC,
            0,
        )
    };
    if fd < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: the descriptor was just made, is valid and belongs to nobody else.
    Ok(unsafe { OwnedFd::from_raw_fd(fd) })
}

/// What an Ethernet frame holds behind its header (IEEE 802.3).
const LONGEST_PAYLOAD: libc::c_int = 1500;

/// What a question about the interface of this name is put in.
fn request(name: &CString) -> libc::ifreq {
    // SAFETY: ifreq is plain data, for which all zeros are a value.
    let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
    // One byte is left for the end mark.
    let room = request.ifr_name.len() - 1;
    for (to, from) in request.ifr_name.iter_mut().zip(name.as_bytes()).take(room) {
        *to = from.cast_signed() as libc::c_char;
    }
    request
}

fn is_up(socket: &OwnedFd, name: &CString) -> io::Result<bool> {
    let mut request = request(name);
    // SAFETY: SIOCGIFFLAGS reads and writes one ifreq, which is valid until the call is over.
    let result = unsafe { libc::ioctl(socket.as_raw_fd(), libc::SIOCGIFFLAGS, &raw mut request) };
    if result < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: the call succeeded, so the kernel has filled in this field of the union.
    let flags = unsafe { request.ifr_ifru.ifru_flags };
    Ok(libc::c_int::from(flags) & libc::IFF_UP != 0)
}

fn mtu(socket: &OwnedFd, name: &CString) -> io::Result<libc::c_int> {
    let mut request = request(name);
    // SAFETY: SIOCGIFMTU reads and writes one ifreq, which is valid until the call is over.
    let result = unsafe { libc::ioctl(socket.as_raw_fd(), libc::SIOCGIFMTU, &raw mut request) };
    if result < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: the call succeeded, so the kernel has filled in this field of the union.
    Ok(unsafe { request.ifr_ifru.ifru_mtu })
}

pub(super) fn set_option<T>(socket: &OwnedFd, option: libc::c_int, value: &T) -> io::Result<()> {
    let length = libc::socklen_t::try_from(size_of::<T>()).map_err(io::Error::other)?;
    // SAFETY: the value is valid until the call is over and its own length is passed.
    let result = unsafe {
        libc::setsockopt(
            socket.as_raw_fd(),
            libc::SOL_PACKET,
            option,
            std::ptr::from_ref(value).cast(),
            length,
        )
    };
    if result < 0 {
        return Err(io::Error::last_os_error());
    }
    Ok(())
}

fn bind(socket: &OwnedFd, interface: libc::c_int) -> io::Result<()> {
    // SAFETY: sockaddr_ll is plain data, for which all zeros are a value.
    let mut address: libc::sockaddr_ll = unsafe { std::mem::zeroed() };
    address.sll_family = libc::AF_PACKET as libc::c_ushort;
    address.sll_protocol = ETHERTYPE.to_be();
    address.sll_ifindex = interface;
    let length =
        libc::socklen_t::try_from(size_of::<libc::sockaddr_ll>()).map_err(io::Error::other)?;
    // SAFETY: the address is valid until the call is over and its own length is passed.
    let result = unsafe { libc::bind(socket.as_raw_fd(), (&raw const address).cast(), length) };
    if result < 0 {
        return Err(io::Error::last_os_error());
    }
    Ok(())
}

impl Link for RawSocket {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        let frame = if frame.len() < SHORTEST_FRAME {
            self.padded.fill(0);
            for (to, from) in self.padded.iter_mut().zip(frame) {
                *to = *from;
            }
            &self.padded[..]
        } else {
            frame
        };
        let sent = send(&self.socket, frame, SendFlags::empty())?;
        if sent != frame.len() {
            return Err(io::ErrorKind::WriteZero.into());
        }
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        Ok(self.ring.take(buffer))
    }

    fn wait(&mut self, until: Duration) {
        // The sleep ends with frames that come, not with one that is there already.
        if !self.ring.is_filled() {
            self.sleeper.wait(&self.socket, until);
        }
    }

    fn now(&self) -> Duration {
        waiting::now()
    }

    fn waker(&self) -> Waker {
        self.sleeper.waker()
    }
}

#[cfg(test)]
mod tests {
    use super::{RawSocket, RawSocketError};

    #[test]
    fn an_interface_that_is_missing_is_named_in_the_error() {
        let Err(error) = RawSocket::open("no-such-if0") else {
            panic!("opened an interface that does not exist");
        };
        assert!(matches!(error, RawSocketError::NoInterface(_)));
        assert_eq!(
            error.to_string(),
            "there is no network interface `no-such-if0`"
        );
    }

    #[test]
    fn a_name_with_a_zero_byte_is_no_interface() {
        assert!(matches!(
            RawSocket::open("a\0b"),
            Err(RawSocketError::NoInterface(_))
        ));
    }
}
