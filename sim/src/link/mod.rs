//! A raw socket on a network interface, by which a segment answers EtherCAT frames of another program or machine.
//! The only place of this crate with `unsafe`: the socket calls of the C library.
#![allow(unsafe_code)]

use core::time::Duration;
use std::ffi::CString;
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};

/// Ethertype of EtherCAT.
const ETHERTYPE: u16 = 0x88A4;
/// Longest Ethernet frame without its checksum, with some room.
pub const FRAME_CAPACITY: usize = 2048;

/// Why an interface could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// There is no interface of this name.
    #[error("there is no network interface {0:?}")]
    NoInterface(String),
    /// The interface is there but down.
    #[error("network interface {0} is down (ip link set {0} up)")]
    Down(String),
    /// Raw sockets are not allowed for this process.
    #[error("no permission for raw sockets on {0}: run as root or give the program CAP_NET_RAW")]
    NoPermission(String),
    /// Anything else that the operating system refused.
    #[error("{call} failed on {interface}: {source}")]
    System {
        /// The call that failed.
        call: &'static str,
        /// The interface that was to be opened.
        interface: String,
        /// What the operating system said.
        source: io::Error,
    },
}

/// A raw socket that sees the EtherCAT frames of one interface, but not those that it sends itself.
#[derive(Debug)]
pub struct RawSocket {
    socket: OwnedFd,
}

impl RawSocket {
    /// Opens the interface.
    ///
    /// # Errors
    ///
    /// [`OpenError::NoInterface`] and [`OpenError::Down`] when the interface cannot be used, [`OpenError::NoPermission`]
    /// without the right to raw sockets, [`OpenError::System`] for anything else.
    pub fn open(interface: &str) -> Result<Self, OpenError> {
        let name =
            CString::new(interface).map_err(|_| OpenError::NoInterface(interface.to_owned()))?;
        // SAFETY: the pointer is to a string that ends with zero and outlives the call.
        let index = unsafe { libc::if_nametoindex(name.as_ptr()) };
        if index == 0 {
            return Err(OpenError::NoInterface(interface.to_owned()));
        }
        let failed = |call| OpenError::System {
            call,
            interface: interface.to_owned(),
            source: io::Error::last_os_error(),
        };
        let protocol = ETHERTYPE.to_be();
        // SAFETY: no pointer is passed.
        let raw = unsafe {
            libc::socket(
                libc::AF_PACKET,
                libc::SOCK_RAW | libc::SOCK_CLOEXEC | libc::SOCK_NONBLOCK,
                i32::from(protocol),
            )
        };
        if raw < 0 {
            return Err(match io::Error::last_os_error().raw_os_error() {
                Some(libc::EPERM | libc::EACCES) => OpenError::NoPermission(interface.to_owned()),
                _ => failed("socket"),
            });
        }
        // SAFETY: the descriptor was just opened and belongs to nobody else.
        let socket = unsafe { OwnedFd::from_raw_fd(raw) };
        if !is_up(&socket, &name).map_err(|()| failed("ioctl(SIOCGIFFLAGS)"))? {
            return Err(OpenError::Down(interface.to_owned()));
        }
        let on: libc::c_int = 1;
        set_option(&socket, libc::PACKET_IGNORE_OUTGOING, &on)
            .map_err(|()| failed("setsockopt(PACKET_IGNORE_OUTGOING)"))?;
        let interface_index = libc::c_int::try_from(index)
            .map_err(|_| OpenError::NoInterface(interface.to_owned()))?;
        let promiscuous = libc::packet_mreq {
            mr_ifindex: interface_index,
            mr_type: libc::PACKET_MR_PROMISC as libc::c_ushort,
            mr_alen: 0,
            mr_address: [0; 8],
        };
        set_option(&socket, libc::PACKET_ADD_MEMBERSHIP, &promiscuous)
            .map_err(|()| failed("setsockopt(PACKET_ADD_MEMBERSHIP)"))?;
        let address = libc::sockaddr_ll {
            sll_family: libc::AF_PACKET as libc::c_ushort,
            sll_protocol: protocol,
            sll_ifindex: interface_index,
            sll_hatype: 0,
            sll_pkttype: 0,
            sll_halen: 0,
            sll_addr: [0; 8],
        };
        // SAFETY: the pointer is to an address of the length that is passed, and outlives the call.
        let bound = unsafe {
            libc::bind(
                socket.as_raw_fd(),
                (&raw const address).cast(),
                size_of::<libc::sockaddr_ll>() as libc::socklen_t,
            )
        };
        if bound < 0 {
            return Err(failed("bind"));
        }
        Ok(Self { socket })
    }

    /// Waits until a frame can be read, or the time is over; whole milliseconds, rounded up.
    ///
    /// # Errors
    ///
    /// What the operating system says, except for an interruption by a signal, which counts as the time being over.
    pub fn wait(&self, timeout: Duration) -> io::Result<()> {
        let mut descriptor = libc::pollfd {
            fd: self.socket.as_raw_fd(),
            events: libc::POLLIN,
            revents: 0,
        };
        let milliseconds = libc::c_int::try_from(timeout.as_nanos().div_ceil(1_000_000))
            .unwrap_or(libc::c_int::MAX);
        // SAFETY: the pointer is to one descriptor entry, as the count says, and outlives the call.
        let ready = unsafe { libc::poll(&raw mut descriptor, 1, milliseconds) };
        if ready < 0 {
            let error = io::Error::last_os_error();
            if error.kind() != io::ErrorKind::Interrupted {
                return Err(error);
            }
        }
        Ok(())
    }

    /// Reads a frame if one is there: its length in the buffer. Frames that do not fit are cut to the buffer.
    ///
    /// # Errors
    ///
    /// What the operating system says; an interface that is down for a while is no error.
    pub fn receive(&self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        // SAFETY: pointer and length are those of a buffer that outlives the call.
        let read = unsafe {
            libc::recv(
                self.socket.as_raw_fd(),
                buffer.as_mut_ptr().cast(),
                buffer.len(),
                0,
            )
        };
        match usize::try_from(read) {
            Ok(length) => Ok(Some(length)),
            Err(_) => would_block(io::Error::last_os_error()).map(|()| None),
        }
    }

    /// Sends a frame. One that does not fit into the send queue is lost, as it would be on a cable.
    ///
    /// # Errors
    ///
    /// What the operating system says; an interface that is down for a while is no error.
    pub fn send(&self, frame: &[u8]) -> io::Result<()> {
        // SAFETY: pointer and length are those of a slice that outlives the call.
        let sent = unsafe {
            libc::send(
                self.socket.as_raw_fd(),
                frame.as_ptr().cast(),
                frame.len(),
                0,
            )
        };
        if sent < 0 {
            would_block(io::Error::last_os_error())
        } else {
            Ok(())
        }
    }
}

/// For socket options and system calls of a program's own.
impl AsFd for RawSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

/// An error that only says "not now" is none; an interface that went down may come up again.
fn would_block(error: io::Error) -> io::Result<()> {
    match error.raw_os_error() {
        Some(libc::EAGAIN | libc::EINTR | libc::ENOBUFS | libc::ENETDOWN) => Ok(()),
        _ => Err(error),
    }
}

/// Whether the interface is up.
fn is_up(socket: &OwnedFd, name: &CString) -> Result<bool, ()> {
    // SAFETY: all zero bytes are a valid request.
    let mut request: libc::ifreq = unsafe { core::mem::zeroed() };
    let bytes = name.as_bytes_with_nul();
    if bytes.len() > request.ifr_name.len() {
        return Err(());
    }
    for (target, byte) in request.ifr_name.iter_mut().zip(bytes) {
        *target = *byte as libc::c_char;
    }
    // SAFETY: the pointer is to a request with a name that ends with zero, and outlives the call.
    let result = unsafe { libc::ioctl(socket.as_raw_fd(), libc::SIOCGIFFLAGS, &raw mut request) };
    if result < 0 {
        return Err(());
    }
    // SAFETY: the call has filled in the flags.
    let flags = unsafe { request.ifr_ifru.ifru_flags };
    Ok(libc::c_int::from(flags) & libc::IFF_UP != 0)
}

fn set_option<T>(socket: &OwnedFd, option: libc::c_int, value: &T) -> Result<(), ()> {
    // SAFETY: pointer and length are those of a value that outlives the call.
    let result = unsafe {
        libc::setsockopt(
            socket.as_raw_fd(),
            libc::SOL_PACKET,
            option,
            core::ptr::from_ref(value).cast(),
            size_of::<T>() as libc::socklen_t,
        )
    };
    if result < 0 { Err(()) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interface_that_does_not_exist_is_named_in_the_error() {
        let error = RawSocket::open("nosuchif0").unwrap_err();
        assert_eq!(
            error.to_string(),
            "there is no network interface \"nosuchif0\""
        );
        assert!(matches!(
            RawSocket::open("zero\0inside"),
            Err(OpenError::NoInterface(_))
        ));
    }
}
