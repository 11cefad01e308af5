//! The floor: the frames of this library's cycle, sent and received by bare system calls.

use std::{fs, os::fd::AsFd, path::Path, time::Duration};

use rustix::{
    io::{Errno, ioctl_fionbio},
    net::{
        RecvFlags, SendFlags, recv, send,
        sockopt::{Timeout, set_socket_timeout},
    },
};
use servocrab_sim::link::{FRAME_CAPACITY, RawSocket};

use crate::measure::{Measured, Mode, cycles, serve};

/// The shortest Ethernet frame.
const SHORTEST: usize = 60;

/// Sends the frames of the file, waits until as many are back, and so on.
pub(crate) fn floor(interface: &str, spin: bool, frames: &Path) {
    serve(exchange(interface, spin, frames));
}

/// What runs so many of these cycles.
pub(crate) fn exchange(
    interface: &str,
    spin: bool,
    frames: &Path,
) -> impl FnMut(Mode, usize) -> Measured + use<> {
    let frames = read_frames(frames);
    let socket = RawSocket::open(interface).expect("the interface is there");
    ioctl_fionbio(socket.as_fd(), spin).expect("a socket can block");
    // Longer than any hiccup: then it has failed.
    let patient = Some(Duration::from_secs(5));
    set_socket_timeout(socket.as_fd(), Timeout::Recv, patient).expect("a time-out");
    let mut buffer = [0; FRAME_CAPACITY];
    move |mode, count| {
        cycles(mode, count, spin, || {
            let socket = socket.as_fd();
            for frame in &frames {
                send(socket, frame, SendFlags::empty()).expect("a frame is taken");
            }
            for _ in &frames {
                loop {
                    match recv(socket, &mut buffer, RecvFlags::empty()) {
                        Ok(_) => break,
                        Err(Errno::AGAIN) if spin => {}
                        Err(error) => panic!("{error}"),
                    }
                }
            }
        })
    }
}

/// One frame behind the other, each with its length in front.
pub(crate) fn write_frames(file: &Path, frames: &[Vec<u8>]) {
    let mut bytes = Vec::new();
    for frame in frames {
        let length = frame.len().max(SHORTEST);
        bytes.extend((length as u16).to_le_bytes());
        bytes.extend(frame);
        bytes.resize(bytes.len() + length - frame.len(), 0);
    }
    fs::write(file, bytes).expect("the directory can be written");
}

fn read_frames(file: &Path) -> Vec<Vec<u8>> {
    let bytes = fs::read(file).expect("the library has been here before");
    let mut rest = &bytes[..];
    let mut frames = Vec::new();
    while let [low, high, more @ ..] = rest {
        let (frame, more) = more.split_at(usize::from(u16::from_le_bytes([*low, *high])));
        frames.push(frame.to_vec());
        rest = more;
    }
    frames
}
