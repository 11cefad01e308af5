//! Received frames in memory that the kernel shares with the process (packet(7), `PACKET_RX_RING` in the form of `TPACKET_V2`).
//! Taking one out is no system call, and neither is seeing that there is none.
#![allow(unsafe_code)]

use std::{
    io,
    mem::offset_of,
    os::fd::{AsRawFd, OwnedFd},
    ptr::NonNull,
    slice,
    sync::atomic::{AtomicU32, Ordering},
};

use super::raw::set_option;

/// Bytes of a slot: the kernel's header of some 66 bytes, and the longest frame.
const SLOT: usize = 2048;
/// The frames of the longest cycle (255) come in while the thread takes them out. There is room enough for those that wait after a
/// cycle that the thread slept through. Further ones are lost.
const SLOTS: usize = 256;
const BYTES: usize = SLOT * SLOTS;
const HEADER: usize = size_of::<libc::tpacket2_hdr>();

/// The slots, which kernel and process own in turns: whose one is says the slot's status.
pub(super) struct Ring {
    memory: NonNull<u8>,
    /// The slot that the kernel fills next, or has filled.
    next: usize,
}

// SAFETY: the mapping belongs to the process, not to a thread, and there is one owner of it.
unsafe impl Send for Ring {}

impl Ring {
    /// Has this socket receive into a ring from now on.
    pub(super) fn new(socket: &OwnedFd) -> io::Result<Self> {
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
    pub(super) fn is_filled(&self) -> bool {
        self.status().load(Ordering::Acquire) & libc::TP_STATUS_USER != 0
    }

    /// Takes the oldest frame out, if there is one, and gives its length. Frames that are longer than `buffer` are dropped.
    pub(super) fn take(&mut self, buffer: &mut [u8]) -> Option<usize> {
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
