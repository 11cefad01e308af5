//! The EtherCAT frames on an interface as a pcapng file, for Wireshark: those that a program sends, and those that come in.
//!
//! It listens beside a running program, and sends nothing.

use std::{
    borrow::Cow,
    fs::File,
    io::{self, BufWriter, IoSliceMut, Write},
    os::fd::{AsRawFd, OwnedFd},
    path::{Path, PathBuf},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use clap::Args;
use nix::{
    cmsg_space,
    errno::Errno,
    ifaddrs::getifaddrs,
    net::if_::InterfaceFlags,
    sys::{
        socket::{
            AddressFamily, ControlMessageOwned, LinkAddr, MsgFlags, SockFlag, SockProtocol,
            SockType, bind, recvmsg, setsockopt, socket, sockopt,
        },
        time::TimeSpec,
    },
};
use pcap_file::{
    DataLink, Endianness, PcapResult,
    pcapng::{
        PcapNgWriter,
        blocks::{
            enhanced_packet::{EnhancedPacketBlock, EnhancedPacketOption},
            interface_description::{InterfaceDescriptionBlock, InterfaceDescriptionOption},
            section_header::{SectionHeaderBlock, SectionHeaderOption},
        },
    },
};
use serde_json::json;
use servocrab::link::RawSocketError;
use smol::Async;

use crate::output::{Done, Failure, Tool};

/// Sends nothing and changes nothing; a program that uses the interface goes on. Ctrl-C ends it.
#[derive(Args)]
pub(crate) struct Arguments {
    /// The network interface to listen on
    #[arg(long, value_name = "NAME")]
    interface: String,
    /// The pcapng file; one that is there is replaced
    #[arg(long, value_name = "FILE")]
    pcapng: PathBuf,
    /// Ends after so many seconds
    #[arg(long = "for", value_name = "SECONDS")]
    seconds: Option<u32>,
    /// Ends after so many frames
    #[arg(long, value_name = "NUMBER", value_parser = clap::value_parser!(u64).range(1..))]
    frames: Option<u64>,
}

/// The EtherType of EtherCAT, where it stands in a frame.
const ETHERCAT: [u8; 2] = [0x88, 0xA4];
/// Bytes of a frame that are kept. EtherCAT's have up to 1518.
const LONGEST: usize = 2048;
/// Bytes that the kernel keeps for a busy process, where it is allowed: frames of some seconds.
const ROOM: usize = 8 << 20;
/// Frames after which the clock and Ctrl-C have their turn, however many frames wait.
const TURN: u64 = 64;

pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    let mut listener = Listener::open(&arguments.interface)?;
    let mut capture = Capture::create(&arguments.pcapng, &arguments.interface)?;
    tool.note(format_args!(
        "listening on {}, and sending nothing; Ctrl-C ends it",
        arguments.interface
    ));
    let over = async {
        tool.over(arguments.seconds).await;
        Ok(())
    };
    let listened = async {
        let wanted = arguments.frames.unwrap_or(u64::MAX);
        while capture.frames() < wanted {
            let Some(received) = listener.next().await? else {
                tool.note("the interface is down; its frames are written again once it is up");
                continue;
            };
            capture.write(&received, listener.frame(&received))?;
            if capture.frames().is_multiple_of(TURN) {
                smol::future::yield_now().await;
            }
        }
        Ok(())
    };
    let ended: Result<(), Failure> = smol::future::or(listened, over).await;
    let Counts {
        outbound,
        inbound,
        other,
        dropped,
    } = capture.complete()?;
    ended?;
    let frames = outbound + inbound + other;
    let file = arguments.pcapng.display().to_string();
    let mut text = format!("{frames} frames in {file}: {outbound} sent, {inbound} received\n");
    if frames == 0 {
        text += "no EtherCAT frame went by: is this the interface of the line, and does a program run on it?\n";
    }
    if dropped > 0 {
        text += &format!(
            "the kernel has dropped {dropped} frames of any kind, since this computer was too busy to take them\n"
        );
    }
    let json = json!({
        "file": file, "frames": frames, "sent": outbound, "received": inbound, "dropped": dropped,
    });
    tool.say(&json, text)?;
    Ok(true)
}

/// Which way a frame went, by the types of packet(7).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Direction {
    Inbound,
    Outbound,
    /// The kernel has not said it.
    Unknown,
}

impl Direction {
    /// `PACKET_HOST`, `PACKET_BROADCAST`, `PACKET_MULTICAST`, `PACKET_OTHERHOST` and `PACKET_OUTGOING` of linux/if_packet.h.
    const fn of(packet_type: Option<u8>) -> Self {
        match packet_type {
            Some(0..=3) => Self::Inbound,
            Some(4) => Self::Outbound,
            _ => Self::Unknown,
        }
    }

    /// The direction in the flags word of a packet (pcapng, section 4.3.1).
    const fn flags(self) -> Option<u32> {
        match self {
            Self::Inbound => Some(1),
            Self::Outbound => Some(2),
            Self::Unknown => None,
        }
    }
}

/// What the kernel says of a frame.
struct Received {
    length: usize,
    /// From 1970 on.
    time: Duration,
    direction: Direction,
    /// How many frames were dropped until then, where some were.
    dropped: Option<u32>,
    interface: Option<usize>,
}

/// A packet socket that is only read.
struct Listener {
    socket: Async<OwnedFd>,
    interface: usize,
    frame: Vec<u8>,
    control: Vec<u8>,
}

impl Listener {
    fn open(interface: &str) -> Result<Self, Failure> {
        let os = |step: &'static str| {
            let interface = interface.to_owned();
            move |source: io::Error| RawSocketError::Os {
                step,
                interface,
                source,
            }
        };
        let all = getifaddrs().map_err(|error| os("look for the interface")(error.into()))?;
        let mut named = all.filter(|known| known.interface_name == interface);
        let found = named.find_map(|known| {
            let address = known.address?;
            Some((known.flags, *address.as_link_addr()?))
        });
        let (flags, address) =
            found.ok_or_else(|| RawSocketError::NoInterface(interface.to_owned()))?;
        if !flags.contains(InterfaceFlags::IFF_UP) {
            return Err(RawSocketError::InterfaceDown(interface.to_owned()).into());
        }
        // All protocols: frames that this computer sends are shown to such sockets alone. A socket for EtherCAT would also be taken for a
        // master.
        let socket = socket(
            AddressFamily::Packet,
            SockType::Raw,
            SockFlag::SOCK_CLOEXEC,
            SockProtocol::EthAll,
        )
        .map_err(|error| match error {
            Errno::EPERM | Errno::EACCES => RawSocketError::NoPermission,
            _ => os("open a raw socket")(error.into()),
        })?;
        // The address has no protocol, which leaves the socket's own.
        bind(socket.as_raw_fd(), &address).map_err(|error| os("bind")(error.into()))?;
        let set = setsockopt(&socket, sockopt::ReceiveTimestampns, &true);
        set.map_err(|error| os("ask for the times")(error.into()))?;
        // Both are a help that may be refused.
        let _ = setsockopt(&socket, sockopt::RxqOvfl, &1);
        let _ = setsockopt(&socket, sockopt::RcvBufForce, &ROOM)
            .or_else(|_| setsockopt(&socket, sockopt::RcvBuf, &ROOM));
        let socket = Async::new(socket).map_err(|error| os("wait for frames")(error))?;
        Ok(Self {
            socket,
            interface: address.ifindex(),
            frame: vec![0; LONGEST],
            control: cmsg_space!(TimeSpec, u32),
        })
    }

    /// The next EtherCAT frame; none where the interface has gone down.
    async fn next(&mut self) -> Result<Option<Received>, Failure> {
        loop {
            let (frame, control) = (&mut self.frame, &mut self.control);
            let received = self
                .socket
                .read_with(|socket| Ok(receive(socket, frame, control)?))
                .await;
            let received = match received {
                Ok(received) => received,
                Err(error) if error.raw_os_error() == Some(Errno::ENETDOWN as i32) => {
                    return Ok(None);
                }
                Err(error) => return Err(error.into()),
            };
            // Until it was bound, the socket has received those of the other interfaces.
            let is_here = received
                .interface
                .is_none_or(|known| known == self.interface);
            if is_here && self.frame(&received).get(12..14) == Some(&ETHERCAT) {
                return Ok(Some(received));
            }
        }
    }

    /// What was kept of the latest one.
    fn frame(&self, received: &Received) -> &[u8] {
        let kept = received.length.min(LONGEST);
        self.frame.get(..kept).unwrap_or_default()
    }
}

fn receive(socket: &OwnedFd, frame: &mut [u8], control: &mut [u8]) -> nix::Result<Received> {
    let mut parts = [IoSliceMut::new(frame)];
    let flags = MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_TRUNC;
    let message = recvmsg::<LinkAddr>(socket.as_raw_fd(), &mut parts, Some(control), flags)?;
    let (mut time, mut dropped) = (None, None);
    for said in message.cmsgs()? {
        match said {
            ControlMessageOwned::ScmTimestampns(at) => time = Some(Duration::from(at)),
            ControlMessageOwned::RxqOvfl(count) => dropped = Some(count),
            _ => {}
        }
    }
    let now = || SystemTime::now().duration_since(UNIX_EPOCH);
    Ok(Received {
        length: message.bytes,
        time: time.unwrap_or_else(|| now().unwrap_or_default()),
        direction: Direction::of(message.address.map(|address| address.pkttype())),
        dropped,
        interface: message.address.map(|address| address.ifindex()),
    })
}

/// How many frames were written, by their direction, and how many the kernel has dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Counts {
    outbound: u64,
    inbound: u64,
    other: u64,
    dropped: u64,
}

/// The pcapng file.
struct Capture<W: Write> {
    file: String,
    writer: PcapNgWriter<W>,
    counts: Counts,
    /// The kernel's count at the latest frame.
    dropped: u32,
}

impl Capture<BufWriter<File>> {
    fn create(path: &Path, interface: &str) -> Result<Self, Failure> {
        let name = path.display().to_string();
        let file = File::create(path).map_err(|error| format!("{name}: {error}"))?;
        Self::new(BufWriter::new(file), name, interface)
    }
}

impl<W: Write> Capture<W> {
    fn new(output: W, file: String, interface: &str) -> Result<Self, Failure> {
        let begun = || {
            let application = concat!("servocrab ", env!("CARGO_PKG_VERSION"));
            let section = SectionHeaderBlock {
                endianness: Endianness::native(),
                options: vec![SectionHeaderOption::UserApplication(application.into())],
                ..SectionHeaderBlock::default()
            };
            let mut writer = PcapNgWriter::with_section_header(output, section)?;
            writer.write_pcapng_block(InterfaceDescriptionBlock {
                linktype: DataLink::ETHERNET,
                snaplen: LONGEST as u32,
                options: vec![
                    InterfaceDescriptionOption::IfName(Cow::Borrowed(interface)),
                    // Nanoseconds.
                    InterfaceDescriptionOption::IfTsResol(9),
                ],
            })?;
            PcapResult::Ok(writer)
        };
        let writer = begun().map_err(|error| format!("{file}: {error}"))?;
        Ok(Self {
            file,
            writer,
            counts: Counts::default(),
            dropped: 0,
        })
    }

    fn frames(&self) -> u64 {
        self.counts.outbound + self.counts.inbound + self.counts.other
    }

    fn write(&mut self, received: &Received, frame: &[u8]) -> Result<(), Failure> {
        let mut options = Vec::new();
        options.extend(received.direction.flags().map(EnhancedPacketOption::Flags));
        // The kernel's count begins again behind its greatest number.
        let until_now = received.dropped.unwrap_or(self.dropped);
        let dropped = u64::from(until_now.wrapping_sub(self.dropped));
        if dropped > 0 {
            options.push(EnhancedPacketOption::DropCount(dropped));
        }
        let written = self.writer.write_pcapng_block(EnhancedPacketBlock {
            interface_id: 0,
            timestamp: received.time,
            original_len: u32::try_from(received.length).unwrap_or(u32::MAX),
            data: Cow::Borrowed(frame),
            options,
        });
        written.map_err(|error| format!("{}: {error}", self.file))?;
        self.dropped = until_now;
        self.counts.dropped += dropped;
        let counted = match received.direction {
            Direction::Inbound => &mut self.counts.inbound,
            Direction::Outbound => &mut self.counts.outbound,
            Direction::Unknown => &mut self.counts.other,
        };
        *counted += 1;
        Ok(())
    }

    fn complete(self) -> Result<Counts, Failure> {
        let flushed = self.writer.into_inner().flush();
        flushed.map_err(|error| format!("{}: {error}", self.file))?;
        Ok(self.counts)
    }
}

#[cfg(test)]
mod tests {
    use pcap_file::pcapng::{Block, PcapNgReader};

    use super::*;

    #[test]
    fn a_frame_is_written_with_its_time_its_direction_and_what_was_dropped_before_it() {
        let mut output = Vec::new();
        let mut capture = Capture::new(&mut output, "frames".into(), "eth0").unwrap();
        let time = Duration::new(1_700_000_000, 123_456_789);
        for (packet_type, dropped) in [(Some(4), None), (Some(1), Some(3)), (None, Some(3))] {
            let received = Received {
                length: 60,
                time,
                direction: Direction::of(packet_type),
                dropped,
                interface: None,
            };
            capture.write(&received, &[7; 60]).unwrap();
        }
        let counts = capture.complete().unwrap();
        let expected = Counts {
            outbound: 1,
            inbound: 1,
            other: 1,
            dropped: 3,
        };
        assert_eq!(counts, expected);

        let mut reader = PcapNgReader::new(output.as_slice()).unwrap();
        let mut options = Vec::new();
        while let Some(block) = reader.next_block() {
            match block.unwrap() {
                Block::InterfaceDescription(interface) => {
                    let resolution = InterfaceDescriptionOption::IfTsResol(9);
                    assert!(interface.options.contains(&resolution));
                }
                Block::EnhancedPacket(packet) => {
                    assert_eq!((packet.timestamp, packet.original_len), (time, 60));
                    assert_eq!(packet.data, [7; 60].as_slice());
                    options.push(packet.into_owned().options);
                }
                other => panic!("{other:?}"),
            }
        }
        use EnhancedPacketOption::{DropCount, Flags};
        assert_eq!(
            options,
            [vec![Flags(2)], vec![Flags(1), DropCount(3)], vec![]]
        );
    }
}
