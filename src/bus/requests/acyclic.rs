//! ethercrab's datagrams on the link: put together into frames, sent, sent again when they are lost, and checked when they
//! come back.
//!
//! ethercrab makes a frame for each datagram. What is queued at the same time shares frames here, and each datagram gets its
//! own answer back with its own working counter: a line of drives costs hardly more system calls than one.
//!
//! ethercrab matches a reply by datagram index and command alone, so that it can give a late one to a later request.
//! Therefore each frame gets a number of its own in its tag, and all its datagrams are compared.
//! What reads or writes a mailbox is sent once, in frames of its own: a second reading would bring the next message in the place
//! of the lost one, and a second writing might be carried out twice. The mailbox client knows what to do about either.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    task::{Wake, Waker},
    time::Duration,
};

use ethercrab::{
    PduRx, PduTx,
    error::{Error, PduError},
};

use crate::{
    bus::{
        cable::time_on_cable,
        cycle::{
            AcyclicWindow,
            frame::{self, BEHIND_TAG, DATAGRAM_HEADER, ETHERNET_HEADER, HEADERS, Tag, command},
            statistics::Counters,
        },
        requests::SLOTS,
    },
    link::{LONGEST_FRAME, Link},
};

/// How long a frame may be away before it is sent again. A segment answers within microseconds; the rest is the
/// operating system's.
const RESEND_AFTER: Duration = Duration::from_millis(20);
/// How often a frame is sent.
const SENDINGS: u8 = 5;
/// After this nothing of a request is on its way or will be sent any more.
pub(in crate::bus) const GIVEN_UP_AFTER: Duration =
    RESEND_AFTER.saturating_mul(SENDINGS as u32 + 1);

/// How many requests may follow one without an answer: with those that are made before the next look, which have a slot
/// each, fewer than ethercrab has indices.
const AHEAD: u32 = 256 - 2 * SLOTS as u32;

/// The two ends of ethercrab's loop that face the link, and the frames that are on their way.
pub(in crate::bus) struct Acyclic {
    tx: PduTx<'static>,
    rx: PduRx<'static>,
    /// Set by ethercrab: to look for what it has queued is to look at all of its slots.
    dirty: Arc<DirtyFlag>,
    call: Waker,
    /// The number of the last frame.
    number: u32,
    /// How many requests there were.
    requests: u32,
    in_flight: Vec<FrameInFlight>,
    spare: Vec<FrameInFlight>,
    /// An answer to one request, as ethercrab takes it.
    single: Vec<u8>,
    /// Until when the wire is busy with what was sent.
    busy_until: Duration,
    /// Something waits for room on the wire, or for the link.
    held: bool,
}

/// Whether ethercrab may have something queued.
struct DirtyFlag(AtomicBool);

impl Wake for DirtyFlag {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// A frame with the requests that share it.
#[derive(Default)]
struct FrameInFlight {
    number: u32,
    /// The number of its first request.
    first: u32,
    frame: Vec<u8>,
    parts: Vec<Part>,
    sent_at: Duration,
    sendings: u8,
    most_sendings: u8,
    /// Whether the link did not take it at least once.
    refused: bool,
}

/// A request's place in its frame.
struct Part {
    start: usize,
    end: usize,
    /// Where its last datagram begins.
    last: usize,
}

impl Acyclic {
    pub fn new(tx: PduTx<'static>, rx: PduRx<'static>) -> Self {
        let slots = tx.capacity();
        let dirty = Arc::new(DirtyFlag(AtomicBool::new(true)));
        Self {
            tx,
            rx,
            call: Waker::from(Arc::clone(&dirty)),
            dirty,
            number: 0,
            requests: 0,
            in_flight: Vec::with_capacity(slots),
            spare: (0..slots)
                .map(|_| FrameInFlight::with_room(slots))
                .collect(),
            single: Vec::with_capacity(LONGEST_FRAME),
            busy_until: Duration::ZERO,
            held: false,
        }
    }

    /// Whether there may be something to send although no future was polled.
    pub fn has_work(&self, now: Duration) -> bool {
        self.held || self.next().is_some_and(|next| now >= next)
    }

    /// Sends what ethercrab has queued, and again what is overdue, as far as it is back before the window ends; the rest waits for
    /// the next one. Without cycles there is no window, and no limit. True when ethercrab has nothing left.
    ///
    /// What the link does not take is tried again with each call, for as long as an answer would be waited for, and counts as lost
    /// then: whoever waits for it gets the error, and nothing else waits behind it.
    pub fn send(
        &mut self,
        link: &mut dyn Link,
        window: Option<AcyclicWindow>,
        counters: &Counters,
    ) -> bool {
        let now = link.now();
        self.held = true;
        // Without cycles nothing has to make room for anything.
        self.busy_until = window.map_or(now, |_| self.busy_until.max(now));
        let mut all = self.collect(now, window);
        let mut refused = false;
        for in_flight in &mut self.in_flight {
            let overdue = now >= in_flight.sent_at.saturating_add(RESEND_AFTER);
            if in_flight.sendings == 0 || overdue && in_flight.sendings < in_flight.most_sendings {
                if overdue {
                    let takes = time_on_cable(in_flight.frame.len());
                    if window.is_some_and(|window| !window.has_room(now, self.busy_until, takes)) {
                        all = false;
                        continue;
                    }
                    self.busy_until += takes;
                }
                if link.send(&in_flight.frame).is_err() {
                    if !in_flight.refused {
                        in_flight.refused = true;
                        counters.not_sent.add();
                    }
                    if !overdue {
                        refused = true;
                        continue;
                    }
                }
                in_flight.sent_at = now;
                in_flight.sendings += 1;
            }
        }
        let mut place = 0;
        while let Some(in_flight) = self.in_flight.get(place) {
            let again = (1..in_flight.most_sendings).contains(&in_flight.sendings);
            if again || now < in_flight.sent_at.saturating_add(RESEND_AFTER) {
                place += 1;
                continue;
            }
            let mut in_flight = self.in_flight.swap_remove(place);
            for part in &in_flight.parts {
                give_up(part, &mut in_flight.frame, &mut self.single, &mut self.rx);
            }
            self.spare.push(in_flight);
        }
        self.held = !all || refused;
        all
    }

    /// Takes what ethercrab has queued into frames that are still to be sent, as far as the window has room. True when it is all.
    fn collect(&mut self, now: Duration, window: Option<AcyclicWindow>) -> bool {
        if !self.dirty.0.swap(false, Ordering::Relaxed) {
            return true;
        }
        // It forgets whom it has told.
        self.tx.replace_waker(&self.call);
        loop {
            let Some(sendable) = self.tx.next_sendable_frame() else {
                return true;
            };
            // An error leaves the request with ethercrab, which offers it again.
            let collected = sendable.send_blocking(|bytes| {
                let Some(datagrams) = bytes.get(HEADERS..) else {
                    return Err(Error::SendFrame);
                };
                let once = frame::reaches_memory(bytes);
                let most_sendings = if once { 1 } else { SENDINGS };
                let open = self.in_flight.iter().position(|in_flight| {
                    in_flight.sendings == 0
                        && in_flight.most_sendings == most_sendings
                        && in_flight.frame.len() + datagrams.len() <= LONGEST_FRAME
                });
                let more = match open.and_then(|place| self.in_flight.get(place)) {
                    Some(in_flight) => {
                        let length = in_flight.frame.len();
                        time_on_cable(length + datagrams.len()) - time_on_cable(length)
                    }
                    None => time_on_cable(BEHIND_TAG + datagrams.len()),
                };
                if window.is_some_and(|window| !window.has_room(now, self.busy_until, more)) {
                    return Err(Error::SendFrame);
                }
                self.busy_until += more;
                self.requests = self.requests.wrapping_add(1);
                let place = open.unwrap_or_else(|| {
                    self.number = self.number.wrapping_add(1);
                    let mut in_flight = self.spare.pop().unwrap_or_default();
                    in_flight.begin(self.number, self.requests, now);
                    in_flight.most_sendings = most_sendings;
                    self.in_flight.push(in_flight);
                    self.in_flight.len() - 1
                });
                if let Some(in_flight) = self.in_flight.get_mut(place) {
                    in_flight.add(datagrams);
                }
                Ok(bytes.len())
            });
            if collected.is_err() {
                self.call.wake_by_ref();
                return false;
            }
        }
    }

    /// Whether nothing more is to be asked for before the oldest request has had its answer or is given up.
    ///
    /// ethercrab finds the request of an answer by the datagram's index alone, and goes round its 256 indices: of two
    /// requests under way with the same one, either might get the other's answer.
    pub fn is_ahead(&self) -> bool {
        self.in_flight
            .iter()
            .any(|in_flight| self.requests.wrapping_sub(in_flight.first) >= AHEAD)
    }

    /// When the next frame is overdue. None while something is held: that ends with the next cycle.
    pub fn next(&self) -> Option<Duration> {
        if self.held {
            return None;
        }
        self.in_flight
            .iter()
            .map(|a| a.sent_at.saturating_add(RESEND_AFTER))
            .min()
    }

    /// Hands the answers in a frame with this number to ethercrab, if it is the answer to one that is away.
    /// `cycle` is when the last cycle was sent.
    pub fn accept(
        &mut self,
        number: u32,
        answer: &[u8],
        cycle: Option<Duration>,
        counters: &Counters,
    ) {
        let Some(place) = self.in_flight.iter().position(|a| a.number == number) else {
            counters.late.add();
            return;
        };
        let fits = self
            .in_flight
            .get(place)
            .is_some_and(|in_flight| frame::is_answer_to(answer, &in_flight.frame));
        if !fits {
            counters.damaged.add();
            return;
        }
        let in_flight = self.in_flight.swap_remove(place);
        if cycle.is_some_and(|cycle| cycle > in_flight.sent_at) {
            counters.acyclic_in_cycle.add();
        }
        for part in &in_flight.parts {
            // An error means that the request's future was dropped meanwhile: nobody waits for the answer.
            if !part.take_out(answer, &mut self.single)
                || self.rx.receive_frame(&self.single).is_err()
            {
                counters.late.add();
            }
        }
        self.spare.push(in_flight);
    }
}

impl FrameInFlight {
    /// One that takes this many requests without growing.
    fn with_room(requests: usize) -> Self {
        Self {
            frame: Vec::with_capacity(LONGEST_FRAME),
            parts: Vec::with_capacity(requests),
            ..Self::default()
        }
    }

    /// A frame without requests.
    fn begin(&mut self, number: u32, first: u32, now: Duration) {
        self.number = number;
        self.first = first;
        frame::begin(&mut self.frame, Tag::Acyclic(number));
        self.parts.clear();
        self.sent_at = now;
        self.sendings = 0;
        self.refused = false;
    }

    /// Appends a request's datagrams.
    fn add(&mut self, datagrams: &[u8]) {
        if let Some(before) = self.parts.last() {
            set_more(&mut self.frame, before.last, true);
        }
        let start = self.frame.len();
        self.frame.extend_from_slice(datagrams);
        set_length(&mut self.frame);
        let last = frame::datagrams_from(&self.frame, start)
            .flatten()
            .last()
            .map_or(start, |datagram| datagram.offset - DATAGRAM_HEADER);
        let end = self.frame.len();
        self.parts.push(Part { start, end, last });
    }
}

impl Part {
    /// Makes a frame of its own of its datagrams in `frame`; false if they are not there.
    fn take_out(&self, frame: &[u8], single: &mut Vec<u8>) -> bool {
        single.clear();
        let (Some(headers), Some(datagrams)) =
            (frame.get(..HEADERS), frame.get(self.start..self.end))
        else {
            return false;
        };
        single.extend_from_slice(headers);
        single.extend_from_slice(datagrams);
        set_length(single);
        set_more(single, HEADERS + self.last - self.start, false);
        true
    }
}

/// Ends a request that has had no answer: as its answer ethercrab gets one with another command, which the request's
/// future takes for undecodable ([`is_lost`]).
fn give_up(part: &Part, frame: &mut [u8], single: &mut Vec<u8>, rx: &mut PduRx<'static>) {
    if let Some(command) = frame.get_mut(part.start) {
        *command = command::NOP;
    }
    if part.take_out(frame, single) {
        // An error means that its future was dropped meanwhile.
        let _ = rx.receive_frame(single);
    }
}

/// Whether this is how a request ends that was given up.
pub(in crate::bus) fn is_lost(error: &Error) -> bool {
    *error == Error::Pdu(PduError::Decode)
}

/// Has the EtherCAT header say how many bytes follow it (eleven bits; type 1 above them).
fn set_length(frame: &mut [u8]) {
    let length = u16::try_from(frame.len() - HEADERS).unwrap_or(u16::MAX) & 0x07FF;
    let header = (0x1000 | length).to_le_bytes();
    for (to, from) in frame.iter_mut().skip(ETHERNET_HEADER).zip(header) {
        *to = from;
    }
}

/// Sets or clears a datagram's mark that another one follows (bit 15 of its length).
fn set_more(frame: &mut [u8], datagram: usize, more: bool) {
    if let Some(flags) = frame.get_mut(datagram + 7) {
        *flags = *flags & 0x7F | u8::from(more) << 7;
    }
}
