//! A raw socket (AF_PACKET, Linux) on one network interface.
#![allow(unsafe_code)]

use rustix::{
    event::{
        EventfdFlags,
        epoll::{self, CreateFlags, EventData, EventFlags},
        eventfd,
    },
    io::{Errno, ioctl_fionread},
    net::{RecvFlags, SendFlags, recv, send, sockopt::socket_error},
    time::{
        ClockId, Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, Timespec,
        clock_gettime, timerfd_create, timerfd_settime,
    },
};
use std::{
    ffi::CString,
    fs::{self, File},
    io,
    mem::{self, offset_of},
    os::{
        fd::{AsFd, AsRawFd, FromRawFd, OwnedFd},
        unix::fs::MetadataExt,
    },
    ptr::NonNull,
    slice,
    sync::{
        Arc,
        atomic::{AtomicU32, Ordering},
    },
    task::{Wake, Waker},
    thread::{self, JoinHandle},
    time::Duration,
};

use super::{ETHERTYPE, Link, SHORTEST_FRAME};

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
    interface: String,
    index: libc::c_int,
    socket: OwnedFd,
    /// None until it is prepared: each frame is a system call until then.
    ring: Option<Ring>,
    /// The socket with the ring. The kernel takes a grace period to make one, in which that socket receives nothing.
    making: Option<JoinHandle<io::Result<(OwnedFd, Ring)>>>,
    /// The socket from before, for which it takes one too.
    closing: Option<JoinHandle<()>>,
    sleeper: Sleeper,
    padded: [u8; SHORTEST_FRAME],
}

impl RawSocket {
    /// Opens a socket on the interface of this name.
    ///
    /// # Errors
    /// No permission, no such interface, the interface is down, another master uses it, or what else the operating system refuses.
    pub fn open(interface: &str) -> Result<Self, RawSocketError> {
        let os = |step| refused(interface, step);
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
        receive_all(&socket, index).map_err(os("receive all frames"))?;
        bind(&socket, index).map_err(os("bind"))?;
        // Before anything is sent. Not before binding: of two that begin together none would see the other.
        if is_taken(&socket, index).map_err(os("look who else uses it"))? {
            return Err(RawSocketError::InUse(interface.to_owned()));
        }
        let making = thread::Builder::new()
            .name("servocrab-ring".into())
            .spawn(move || {
                let socket = open_socket()?;
                receive_all(&socket, index)?;
                let ring = Ring::new(&socket)?;
                Ok((socket, ring))
            })
            .map_err(os("make a thread"))?;
        Ok(Self {
            interface: interface.to_owned(),
            index,
            ring: None,
            making: Some(making),
            closing: None,
            sleeper: Sleeper::new(&socket).map_err(os("prepare to sleep"))?,
            socket,
            padded: [0; SHORTEST_FRAME],
        })
    }
}

/// What becomes of a refusal of the operating system.
fn refused(interface: &str, step: &'static str) -> impl Fn(io::Error) -> RawSocketError {
    let interface = interface.to_owned();
    move |source| RawSocketError::Os {
        step,
        interface: interface.clone(),
        source,
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

/// Has a socket that is not bound yet receive all that comes in by the interface.
fn receive_all(socket: &OwnedFd, interface: libc::c_int) -> io::Result<()> {
    // Without this the socket reads its own frames back before the segment's answer.
    set_option(socket, PACKET_IGNORE_OUTGOING, &1i32)?;
    // Answers carry the destination they were sent with, which is the broadcast address: but a switch or a
    // virtual interface may change it.
    let membership = libc::packet_mreq {
        mr_ifindex: interface,
        mr_type: PACKET_MR_PROMISC,
        mr_alen: 0,
        mr_address: [0; 8],
    };
    set_option(socket, libc::PACKET_ADD_MEMBERSHIP, &membership)
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

fn set_option<T>(socket: &OwnedFd, option: libc::c_int, value: &T) -> io::Result<()> {
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
        if let Some(ring) = &mut self.ring {
            return Ok(ring.take(buffer));
        }
        loop {
            // The length is that of the frame, of which as much is given as there is room for.
            match recv(&self.socket, &mut *buffer, RecvFlags::TRUNC) {
                Ok((_, length)) if length > buffer.len() => {}
                Ok((_, length)) => return Ok(Some(length)),
                Err(Errno::AGAIN) => return Ok(None),
                Err(error) => return Err(error.into()),
            }
        }
    }

    fn wait(&mut self, until: Duration) {
        // The sleep ends with frames that come, not with one that is there already.
        let is_there = match &self.ring {
            Some(ring) => ring.is_filled(),
            None => ioctl_fionread(&self.socket).is_ok_and(|bytes| bytes > 0),
        };
        if !is_there {
            self.sleeper.wait(&self.socket, until);
        }
    }

    fn now(&self) -> Duration {
        now()
    }

    fn waker(&self) -> Waker {
        self.sleeper.waker()
    }

    /// Changes over to the socket with the ring. The one from before stays bound until then, so that another master sees it.
    fn prepare(&mut self) -> Result<(), RawSocketError> {
        let Some(making) = self.making.take() else {
            return Ok(());
        };
        let os = |step| refused(&self.interface, step);
        let panicked = |_| Err(io::Error::other("its thread has panicked"));
        let made = making.join().unwrap_or_else(panicked);
        let (socket, ring) = made.map_err(os("make a ring for received frames"))?;
        bind(&socket, self.index).map_err(os("bind"))?;
        let sleeper = &self.sleeper;
        sleeper
            .listen_to(&socket, &self.socket)
            .map_err(os("prepare to sleep"))?;
        self.ring = Some(ring);
        let before = mem::replace(&mut self.socket, socket);
        // Without a thread it is closed here.
        let closing = thread::Builder::new().name("servocrab-close".into());
        self.closing = closing.spawn(move || drop(before)).ok();
        Ok(())
    }
}

impl Drop for RawSocket {
    /// Who opens the interface behind that finds it free.
    fn drop(&mut self) {
        if let Some(closing) = self.closing.take() {
            // It cannot panic.
            let _ = closing.join();
        }
    }
}

// Received frames in memory that the kernel shares with the process (packet(7), `PACKET_RX_RING` in the form of `TPACKET_V2`).
// Taking one out is no system call, and neither is seeing that there is none.

/// Bytes of a slot: the kernel's header of some 66 bytes, and the longest frame.
const SLOT: usize = 2048;
/// The frames of the longest cycle (255) come in while the thread takes them out. There is room enough for those that wait after a
/// cycle that the thread slept through. Further ones are lost.
const SLOTS: usize = 256;
const BYTES: usize = SLOT * SLOTS;
const HEADER: usize = size_of::<libc::tpacket2_hdr>();

/// The slots, which kernel and process own in turns: whose one is says the slot's status.
struct Ring {
    memory: NonNull<u8>,
    /// The slot that the kernel fills next, or has filled.
    next: usize,
}

// SAFETY: the mapping belongs to the process, not to a thread, and there is one owner of it.
unsafe impl Send for Ring {}

impl Ring {
    /// Has this socket receive into a ring from now on.
    pub fn new(socket: &OwnedFd) -> io::Result<Self> {
        // SAFETY: sysconf takes no pointers.
        let page = usize::try_from(unsafe { libc::sysconf(libc::_SC_PAGESIZE) })
            .map_err(io::Error::other)?;
        // Pages one by one are always to be had; a slot may not lie across two.
        let block = page.max(SLOT);
        let number = |count: usize| libc::c_uint::try_from(count).map_err(io::Error::other);
        let version = libc::tpacket_versions::TPACKET_V2 as libc::c_int;
        set_option(socket, libc::PACKET_VERSION, &version)?;
        let request = libc::tpacket_req {
            tp_block_size: number(block)?,
            tp_block_nr: number(BYTES / block)?,
            tp_frame_size: number(SLOT)?,
            tp_frame_nr: number(SLOTS)?,
        };
        set_option(socket, libc::PACKET_RX_RING, &request)?;
        // SAFETY: a new mapping at an address of the kernel's choice, of the length that the ring was made with; the result is checked.
        let memory = unsafe {
            libc::mmap(
                std::ptr::null_mut(),
                BYTES,
                libc::PROT_READ | libc::PROT_WRITE,
                libc::MAP_SHARED | libc::MAP_POPULATE,
                socket.as_raw_fd(),
                0,
            )
        };
        if memory == libc::MAP_FAILED {
            return Err(io::Error::last_os_error());
        }
        let memory = NonNull::new(memory.cast()).ok_or(io::ErrorKind::OutOfMemory)?;
        Ok(Self { memory, next: 0 })
    }

    /// Whether a frame is there.
    pub fn is_filled(&self) -> bool {
        self.status().load(Ordering::Acquire) & libc::TP_STATUS_USER != 0
    }

    /// Takes the oldest frame out, if there is one, and gives its length. Frames that are longer than `buffer` are dropped.
    pub fn take(&mut self, buffer: &mut [u8]) -> Option<usize> {
        while self.is_filled() {
            let slot = self.slot();
            // SAFETY: the slot has an aligned header, of plain integers, which the kernel leaves alone until the status is given back.
            let header = unsafe { slot.cast::<libc::tpacket2_hdr>().read() };
            // SAFETY: these are the rest of the slot's bytes, which the kernel leaves alone until the status is given back, after the last
            // use of this slice.
            let rest = unsafe { slice::from_raw_parts(slot.add(HEADER).as_ptr(), SLOT - HEADER) };
            let length = header.tp_len as usize;
            let taken = usize::from(header.tp_mac)
                .checked_sub(HEADER)
                .and_then(|start| rest.get(start..)?.get(..length))
                .and_then(|frame| {
                    buffer.get_mut(..length)?.copy_from_slice(frame);
                    Some(length)
                });
            self.status()
                .store(libc::TP_STATUS_KERNEL, Ordering::Release);
            self.next = (self.next + 1) % SLOTS;
            if taken.is_some() {
                return taken;
            }
        }
        None
    }

    /// The slot that is filled next, or has been.
    const fn slot(&self) -> NonNull<u8> {
        // SAFETY: `next` is less than SLOTS, so that the slot lies in the mapping, which is valid as long as `self`.
        unsafe { self.memory.add(self.next * SLOT) }
    }

    fn status(&self) -> &AtomicU32 {
        let status = offset_of!(libc::tpacket2_hdr, tp_status);
        // SAFETY: slots begin at multiples of their length in a mapping that begins with a page, so this is aligned; on this side the
        // status is only ever used as this atomic.
        unsafe { AtomicU32::from_ptr(self.slot().add(status).cast().as_ptr()) }
    }
}

impl Drop for Ring {
    fn drop(&mut self) {
        // SAFETY: the mapping was made with this length, and nobody uses it any more.
        unsafe {
            libc::munmap(self.memory.as_ptr().cast(), BYTES);
        }
    }
}

// Whether another program has EtherCAT on an interface. Two masters on one line reset each other's devices, and neither can
// distinguish the other's process data from its own.

/// The packet sockets of the network namespace that this thread is in (packet(7)): their protocol, their interface, their inode.
const SOCKETS: &str = "/proc/thread-self/net/packet";

/// Whether another socket than this one, which is bound, takes the EtherCAT frames of this interface. Of two that look at the same
/// time each sees the other. Where the system does not list its sockets, none is found.
fn is_taken(socket: &OwnedFd, interface: libc::c_int) -> io::Result<bool> {
    let own = File::from(socket.as_fd().try_clone_to_owned()?)
        .metadata()?
        .ino();
    let sockets = fs::read_to_string(SOCKETS).unwrap_or_default();
    Ok(holders(&sockets, interface).any(|inode| inode != own))
}

/// The inodes of the sockets that take EtherCAT frames of this interface. Who receives frames of every protocol captures them, and is
/// no master.
fn holders(sockets: &str, interface: libc::c_int) -> impl Iterator<Item = u64> + '_ {
    // sk RefCnt Type Proto Iface R Rmem User Inode
    sockets.lines().filter_map(move |line| {
        let mut fields = line.split_whitespace().skip(3);
        let protocol = u16::from_str_radix(fields.next()?, 16).ok()?;
        let bound_to: libc::c_int = fields.next()?.parse().ok()?;
        let inode = fields.nth(3)?.parse().ok()?;
        (protocol == ETHERTYPE && bound_to == interface).then_some(inode)
    })
}

// Sleeping until a frame has come, a waker was used or a time has come: one epoll on a socket, an eventfd and a timerfd.

const SOCKET: u64 = 0;
const EVENT: u64 = 1;
const TIMER: u64 = 2;

/// The time of the clock that sleeping goes by.
pub(super) fn now() -> Duration {
    Duration::try_from(clock_gettime(ClockId::Monotonic)).unwrap_or_default()
}

/// Going to sleep for less than this would take longer.
const SHORTEST_SLEEP: Duration = Duration::from_micros(5);

/// What a thread sleeps with. Its timer is exact: the slack of the thread's other timers (prctl(2), `PR_SET_TIMERSLACK`) is not its.
struct Sleeper {
    epoll: OwnedFd,
    timer: OwnedFd,
    /// When the timer rings; none once it was seen to have rung.
    rings: Option<Duration>,
    event: Arc<Event>,
}

impl Sleeper {
    pub fn new(socket: &OwnedFd) -> io::Result<Self> {
        let epoll = epoll::create(CreateFlags::CLOEXEC)?;
        let timer = timerfd_create(
            TimerfdClockId::Monotonic,
            TimerfdFlags::NONBLOCK | TimerfdFlags::CLOEXEC,
        )?;
        let event = Arc::new(Event(eventfd(
            0,
            EventfdFlags::NONBLOCK | EventfdFlags::CLOEXEC,
        )?));
        for (descriptor, data) in [(event.0.as_fd(), EVENT), (timer.as_fd(), TIMER)] {
            epoll::add(&epoll, descriptor, EventData::new_u64(data), EventFlags::IN)?;
        }
        add_socket(&epoll, socket)?;
        Ok(Self {
            epoll,
            timer,
            rings: None,
            event,
        })
    }

    /// Sleeps until more has come on this socket from now on, in place of the one before.
    pub fn listen_to(&self, socket: &OwnedFd, before: &OwnedFd) -> io::Result<()> {
        epoll::delete(&self.epoll, before)?;
        add_socket(&self.epoll, socket)
    }

    /// Sleeps until more has come on `socket`, the waker was used or `until` has come; or until a time that was named before.
    pub fn wait(&mut self, socket: &OwnedFd, until: Duration) {
        // Setting a timer anew costs more than to wake for nothing now and then: one that rings sooner is left as it is.
        if self.rings.is_none_or(|rings| until < rings) {
            self.set_timer(until);
        }
        let mut events = [epoll::Event {
            flags: EventFlags::empty(),
            data: EventData::new_u64(TIMER),
        }; 3];
        // An error (a signal came) is the same as waking early.
        let count = epoll::wait(&self.epoll, &mut events, None).unwrap_or(0);
        for epoll::Event { flags, data } in events.into_iter().take(count) {
            match data.u64() {
                EVENT => self.event.clear(),
                // The interface is down. Reading the error clears it; else the next frame that is sent would be refused for it, when
                // the interface is up again.
                SOCKET if flags.contains(EventFlags::ERR) => {
                    let _ = socket_error(socket);
                }
                // To set it anew is what clears it. Cycles that follow a clock begin a little later than it was set for.
                TIMER => {
                    self.rings = None;
                    if until.saturating_sub(now()) < SHORTEST_SLEEP {
                        while now() < until {
                            std::hint::spin_loop();
                        }
                    }
                }
                _ => {}
            }
        }
    }

    pub fn waker(&self) -> Waker {
        Waker::from(Arc::clone(&self.event))
    }

    fn set_timer(&mut self, at: Duration) {
        // All zeros would be no time at all.
        let at = at.max(Duration::from_nanos(1));
        let Ok(it_value) = Timespec::try_from(at) else {
            return;
        };
        let it_interval = Timespec::default();
        let once = Itimerspec {
            it_interval,
            it_value,
        };
        // It cannot fail with a time and flags that are right.
        if timerfd_settime(&self.timer, TimerfdTimerFlags::ABSTIME, &once).is_ok() {
            self.rings = Some(at);
        }
    }
}

fn add_socket(epoll: &OwnedFd, socket: &OwnedFd) -> io::Result<()> {
    // Without ET the kernel looks at the socket once more with each sleep.
    let flags = EventFlags::IN | EventFlags::ET;
    Ok(epoll::add(
        epoll,
        socket,
        EventData::new_u64(SOCKET),
        flags,
    )?)
}

/// Ends a sleep from any thread.
struct Event(OwnedFd);

impl Event {
    fn clear(&self) {
        // Failing (there was nothing to read) is of no consequence: the descriptor does not block.
        let _ = rustix::io::read(&self.0, &mut [0; 8]);
    }
}

impl Wake for Event {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        // It can only fail when the counter is at its end, and then the descriptor is readable already.
        let _ = rustix::io::write(&self.0, &1u64.to_ne_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::{RawSocket, RawSocketError, holders};

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

    /// As Linux 6.1 writes it: a master on interface 3, one on 4, a capture on 3, a socket that is not bound yet, and something newer.
    const TOLD: &str = "\
sk               RefCnt Type Proto  Iface R Rmem   User   Inode
000000008e539550 3      3    88a4   3     1 0      0      58674 
000000008e539551 3      3    88a4   4     1 0      1000   58675 
000000008e539552 3      3    0003   3     1 0      0      58676 
000000008e539553 3      3    88a4   0     0 0      0      58677 
000000008e539554 3      3    88a4   3
";

    #[test]
    fn of_all_packet_sockets_those_count_that_take_ethercat_frames_of_the_interface() {
        assert_eq!(holders(TOLD, 3).collect::<Vec<_>>(), [58674]);
        assert_eq!(holders(TOLD, 4).collect::<Vec<_>>(), [58675]);
        assert_eq!(holders(TOLD, 5).count(), 0);
        assert_eq!(holders("", 3).count(), 0);
    }
}
