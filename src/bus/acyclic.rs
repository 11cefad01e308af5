//! ethercrab's frames on the link: sent, sent again when they are lost, and checked when they come back.
//!
//! ethercrab matches a reply by datagram index and command alone, so that a late one can be taken for a later request's.
//! Therefore each frame gets a number of its own in its source address, and its datagrams are compared.
//! What reads a mailbox is sent once: a second reading would bring the next mail in the place of the lost one.

use std::{io, time::Duration};

use ethercrab::{PduRx, PduTx, error::Error};

use super::frame::{self, Tag};
use super::statistics::Counters;
use crate::link::Link;

/// How long a frame may be away before it is sent again. A segment answers within microseconds; the rest is the
/// operating system's.
const RESEND_AFTER: Duration = Duration::from_millis(20);
/// How often a frame is sent.
const SENDINGS: u8 = 5;
/// After this nothing of a request is on its way or will be sent any more.
pub(super) const GIVEN_UP_AFTER: Duration = RESEND_AFTER.saturating_mul(SENDINGS as u32 + 1);

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
        let spare = &mut self.spare;
        self.away.retain_mut(|away| {
            let keep = now < away.sent_at + RESEND_AFTER;
            if !keep {
                spare.push(std::mem::take(&mut away.frame));
            }
            keep
        });
        Ok(sent)
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

fn set_source(frame: &mut [u8], number: u32) {
    let address = Tag::Acyclic(number).source_address();
    for (to, from) in frame.iter_mut().skip(6).zip(address) {
        *to = from;
    }
}
