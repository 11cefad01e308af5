//! ethercrab's frames on the link: sent, sent again when they are lost, and checked when they come back.
//!
//! ethercrab matches a reply by datagram index and command alone, so that a late one can be taken for a later request's.
//! Therefore each frame gets a number of its own in its source address, and its datagrams are compared.
//! What reads a mailbox is sent once: a second reading would bring the next mail in the place of the lost one.

use std::{io, time::Duration};

use ethercrab::{
    PduRx, PduTx,
    error::{Error, PduError},
};

use super::frame::{self, Tag, command};
use super::reactor::SLOTS;
use super::statistics::Counters;
use crate::link::Link;

/// How long a frame may be away before it is sent again. A segment answers within microseconds; the rest is the
/// operating system's.
const RESEND_AFTER: Duration = Duration::from_millis(20);
/// How often a frame is sent.
const SENDINGS: u8 = 5;
/// After this nothing of a request is on its way or will be sent any more.
pub(super) const GIVEN_UP_AFTER: Duration = RESEND_AFTER.saturating_mul(SENDINGS as u32 + 1);

/// How many requests may follow one without an answer: with those that are made before the next look, which have a slot
/// each, fewer than ethercrab has indices.
const AHEAD: u32 = 256 - 2 * SLOTS as u32;

/// The two ends of ethercrab's loop that face the link, and the frames that are on their way.
pub(super) struct Acyclic {
    tx: PduTx<'static>,
    rx: PduRx<'static>,
    number: u32,
    away: Vec<Away>,
    spare: Vec<Vec<u8>>,
}

struct Away {
    number: u32,
    frame: Vec<u8>,
    sent_at: Duration,
    sendings: u8,
}

impl Acyclic {
    pub(super) fn new(tx: PduTx<'static>, rx: PduRx<'static>) -> Self {
        let slots = tx.capacity();
        Self {
            tx,
            rx,
            number: 0,
            away: Vec::with_capacity(slots),
            spare: Vec::new(),
        }
    }

    /// Sends what ethercrab has queued, and again what is overdue. Gives the number of frames sent.
    pub(super) fn send(&mut self, link: &mut dyn Link, now: Duration) -> io::Result<usize> {
        let mut sent = 0;
        while let Some(sendable) = self.tx.next_sendable_frame() {
            let mut frame = self.spare.pop().unwrap_or_default();
            self.number = self.number.wrapping_add(1);
            let number = self.number;
            let mut result = Ok(());
            // An error here leaves the frame with ethercrab, which offers it again.
            let taken = sendable.send_blocking(|bytes| {
                frame.clear();
                frame.extend_from_slice(bytes);
                set_source(&mut frame, number);
                result = link.send(&frame);
                match &result {
                    Ok(()) => Ok(bytes.len()),
                    Err(_) => Err(Error::SendFrame),
                }
            });
            result?;
            if taken.is_ok() {
                sent += 1;
                // A mail whose reading is lost is asked for by the mailbox client, which then gets the same one again.
                let sendings = if frame::reads_memory(&frame) {
                    SENDINGS
                } else {
                    1
                };
                self.away.push(Away {
                    number,
                    frame,
                    sent_at: now,
                    sendings,
                });
            }
        }
        for away in &mut self.away {
            if away.sendings < SENDINGS && now >= away.sent_at + RESEND_AFTER {
                away.sent_at = now;
                away.sendings += 1;
                link.send(&away.frame)?;
                sent += 1;
            }
        }
        let (spare, rx) = (&mut self.spare, &mut self.rx);
        self.away.retain_mut(|away| {
            let keep = now < away.sent_at + RESEND_AFTER;
            if !keep {
                let mut frame = std::mem::take(&mut away.frame);
                give_up(&mut frame, rx);
                spare.push(frame);
            }
            keep
        });
        Ok(sent)
    }

    /// Whether nothing more is to be asked for before the oldest request has had its answer or is given up.
    ///
    /// ethercrab finds the request of an answer by the datagram's index alone, and goes round its 256 indices: of two
    /// requests under way with the same one, either might get the other's answer.
    pub(super) fn is_ahead(&self) -> bool {
        self.away
            .iter()
            .any(|away| self.number.wrapping_sub(away.number) >= AHEAD)
    }

    /// When the next frame is overdue.
    pub(super) fn next(&self) -> Option<Duration> {
        self.away.iter().map(|a| a.sent_at + RESEND_AFTER).min()
    }

    /// Hands a frame with this number to ethercrab, if it is the answer to one that is away.
    pub(super) fn accept(&mut self, number: u32, answer: &[u8], counters: &Counters) {
        let Some(place) = self.away.iter().position(|a| a.number == number) else {
            counters.late.add();
            return;
        };
        let fits = self
            .away
            .get(place)
            .is_some_and(|away| frame::is_answer_to(answer, &away.frame));
        if !fits {
            counters.damaged.add();
            return;
        }
        self.spare.push(self.away.swap_remove(place).frame);
        // An error means that the request's future was dropped meanwhile: nobody waits for the answer.
        if self.rx.receive_frame(answer).is_err() {
            counters.late.add();
        }
    }
}

/// Ends a request that has had no answer: as its answer ethercrab gets one with another command, which the request's
/// future takes for undecodable ([`is_lost`]).
fn give_up(frame: &mut [u8], rx: &mut PduRx<'static>) {
    if let Some(command) = frame.get_mut(frame::HEADERS) {
        *command = command::NOP;
    }
    // An error means that its future was dropped meanwhile.
    let _ = rx.receive_frame(frame);
}

/// Whether this is how a request ends that was given up.
pub(super) fn is_lost(error: &Error) -> bool {
    *error == Error::Pdu(PduError::Decode)
}

fn set_source(frame: &mut [u8], number: u32) {
    let address = Tag::Acyclic(number).source_address();
    for (to, from) in frame.iter_mut().skip(6).zip(address) {
        *to = from;
    }
}
