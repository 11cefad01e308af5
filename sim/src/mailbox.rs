//! The mailbox of a SubDevice: messages in, messages out, counters, repeats, and the answers to messages that it cannot use.
//! Message: length u16, address u16, channel u8, type | counter << 4, then the payload (ETG.1000.4).

use core::time::Duration;
use std::collections::VecDeque;

use crate::frame::read_u16;

/// Bytes before the payload.
pub(crate) const HEADER: usize = 6;
/// Type of a message that reports an error of the mailbox itself.
const TYPE_ERROR: u8 = 0;
/// Messages that may wait before the mailbox takes no further request: the next one stays in the sync manager, which is full
/// then. Assumed; real devices have room for few.
const MOST_WAITING: usize = 32;
/// Messages beyond which an emergency is dropped, so that a drive that nobody listens to does not fill the memory.
const MOST_EMERGENCIES: usize = 1024;
/// Types of messages: Ethernet over EtherCAT, CoE, file access.
const TYPE_EOE: u8 = 2;
pub(crate) const TYPE_COE: u8 = 3;
const TYPE_FOE: u8 = 4;
/// The bits of EoE and FoE among the protocols of the SII (ETG.2010).
const SERVES_EOE: u16 = 0x0002;
const SERVES_FOE: u16 = 0x0008;
/// EoE: types of its messages, the mark of a last fragment, and which of its parameters a request sets (ETG.1000.6).
const EOE_FRAGMENT: u8 = 0;
const EOE_SET_IP: u8 = 2;
const EOE_SET_FILTER: u8 = 4;
const EOE_LAST: u8 = 0x01;
const EOE_HAS_MAC: u8 = 0x01;
const EOE_HAS_IP: u8 = 0x02;
/// Result of an EoE request that is not served.
const EOE_UNSUPPORTED: u16 = 0x0002;
/// FoE: an error, and that of a file which is not there.
const FOE_ERROR: u8 = 5;
const FOE_NOT_FOUND: u32 = 0x8001;

/// Why a message was not served, as an error message gives it (ETG.1000.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub(crate) enum MailError {
    UnsupportedProtocol = 2,
    ServiceNotSupported = 4,
    TooShort = 6,
    InvalidSize = 8,
}

/// The gate to the sync managers that the mailbox works through.
pub(crate) trait Post {
    /// Takes the message that the MainDevice wrote.
    fn take(&mut self) -> Option<Vec<u8>>;
    /// Whether the last message that was put still waits to be read.
    fn waits(&self) -> bool;
    /// Puts a message; `false` when that is not possible now.
    fn put(&mut self, mail: &[u8]) -> bool;
    /// Takes back a message that was not read.
    fn withdraw(&mut self);
    /// Whether the MainDevice asks for the last message again.
    fn repeat_is_requested(&self) -> bool;
    /// Says that the repeat request was seen.
    fn acknowledge_repeat(&mut self);
}

/// A message on its way to the MainDevice.
#[derive(Clone, Debug)]
enum Outgoing {
    /// Gets its header, with the next counter, when it is put.
    New { kind: u8, payload: Vec<u8> },
    /// Was put before and keeps its bytes.
    Again(Vec<u8>),
}

/// State of a mailbox.
#[derive(Clone, Debug, Default)]
pub(crate) struct Mailbox {
    /// Counter of the last request; zero before the first.
    last_request: u8,
    /// Counter of the last message sent; zero before the first.
    last_sent: u8,
    /// Number of emergencies at the front of the queue.
    emergencies: usize,
    queue: VecDeque<Outgoing>,
    waiting: Option<Vec<u8>>,
    last_read: Option<Vec<u8>>,
    request: Option<(Duration, u8, Vec<u8>)>,
    /// Time between taking a request and answering it.
    pub(crate) delay: Duration,
    /// A request, by how many are taken before it, that takes this time in place of the other.
    pub(crate) late: Option<(u64, Duration)>,
    /// The protocols that the SII names.
    protocols: u16,
}

impl Mailbox {
    /// A mailbox for these protocols of the SII. CoE is always served.
    pub(crate) fn serving(protocols: u16) -> Self {
        Self {
            protocols,
            ..Self::default()
        }
    }

    /// Forgets everything but the delays and the protocols: INIT was entered.
    pub(crate) fn reset(&mut self) {
        *self = Self {
            delay: self.delay,
            late: self.late,
            protocols: self.protocols,
            ..Self::default()
        };
    }

    /// Queues a CoE message ahead of all replies, behind the emergencies that are queued already.
    pub(crate) fn push_emergency(&mut self, payload: Vec<u8>) {
        if self.queue.len() >= MOST_EMERGENCIES {
            // Nobody reads them. The errors are in the history.
            return;
        }
        let at = self.emergencies.min(self.queue.len());
        self.queue.insert(
            at,
            Outgoing::New {
                kind: TYPE_COE,
                payload,
            },
        );
        self.emergencies = at + 1;
    }

    /// Number of messages that wait behind the one in the sync manager.
    pub(crate) fn queued(&self) -> usize {
        self.queue.len()
    }

    /// Moves messages both ways. `serve` gets the payload of each CoE message and gives the payloads of the replies.
    pub(crate) fn poll<P: Post>(
        &mut self,
        post: &mut P,
        now: Duration,
        mut serve: impl FnMut(&[u8]) -> Result<Vec<Vec<u8>>, MailError>,
    ) {
        if self.waiting.is_some() && !post.waits() {
            self.last_read = self.waiting.take();
        }
        if post.repeat_is_requested() {
            self.repeat(post);
        }
        if self.request.is_none()
            && self.queue.len() < MOST_WAITING
            && let Some(mail) = post.take()
        {
            self.receive(&mail, now);
        }
        if let Some((due, kind, payload)) = self.request.take() {
            if due > now {
                self.request = Some((due, kind, payload));
            } else {
                self.answer(kind, &payload, &mut serve);
            }
        }
        self.send(post);
    }

    /// Puts the message that was read last once more, ahead of everything else.
    fn repeat<P: Post>(&mut self, post: &mut P) {
        if let Some(last) = self.last_read.take() {
            if let Some(unread) = self.waiting.take() {
                post.withdraw();
                self.queue.push_front(Outgoing::Again(unread));
                self.emergencies += 1;
            }
            self.queue.push_front(Outgoing::Again(last));
            self.emergencies += 1;
        }
        post.acknowledge_repeat();
    }

    /// Checks a message's header; a request is kept until it is due.
    fn receive(&mut self, mail: &[u8], now: Duration) {
        let (Some(length), Some(kind)) = (read_u16(mail, 0), mail.get(5)) else {
            return;
        };
        let counter = kind >> 4 & 0x07;
        if counter != 0 && counter == self.last_request {
            // The MainDevice sent it again because it saw no working counter; it was served already.
            return;
        }
        self.last_request = counter;
        if kind & 0x0F == TYPE_ERROR {
            // A complaint of the MainDevice is not answered with one.
            return;
        }
        match mail.get(HEADER..HEADER + usize::from(length)) {
            Some(payload) => {
                let delay = self.next_delay();
                self.request = Some((now.saturating_add(delay), kind & 0x0F, payload.to_vec()));
            }
            None => self.reply_error(MailError::InvalidSize),
        }
    }

    /// How long the next request takes.
    fn next_delay(&mut self) -> Duration {
        match &mut self.late {
            Some((0, late)) => {
                let late = *late;
                self.late = None;
                late
            }
            Some((before, _)) => {
                *before -= 1;
                self.delay
            }
            None => self.delay,
        }
    }

    fn answer(
        &mut self,
        kind: u8,
        payload: &[u8],
        serve: &mut impl FnMut(&[u8]) -> Result<Vec<Vec<u8>>, MailError>,
    ) {
        match kind {
            TYPE_COE => {}
            TYPE_EOE if self.protocols & SERVES_EOE != 0 => return self.answer_ethernet(payload),
            TYPE_FOE if self.protocols & SERVES_FOE != 0 => {
                // It has no files.
                let mut payload = vec![FOE_ERROR, 0];
                payload.extend(FOE_NOT_FOUND.to_le_bytes());
                return self.queue_new(TYPE_FOE, payload);
            }
            _ => return self.reply_error(MailError::UnsupportedProtocol),
        }
        match serve(payload) {
            Ok(payloads) => self
                .queue
                .extend(payloads.into_iter().map(|payload| Outgoing::New {
                    kind: TYPE_COE,
                    payload,
                })),
            Err(error) => self.reply_error(error),
        }
    }

    /// An address is set, and the device says on its network that it has it (a gratuitous ARP), without having been asked. Frames for it
    /// are taken and go nowhere.
    fn answer_ethernet(&mut self, payload: &[u8]) {
        let Some((&kind, rest)) = payload.split_first() else {
            return self.reply_error(MailError::TooShort);
        };
        let result = match kind & 0x0F {
            EOE_FRAGMENT => return,
            EOE_SET_IP => 0,
            EOE_SET_FILTER => EOE_UNSUPPORTED,
            _ => return self.reply_error(MailError::ServiceNotSupported),
        };
        // Each response has the type behind its request's.
        let mut response = vec![kind + 1, EOE_LAST];
        response.extend(u16::to_le_bytes(result));
        self.queue_new(TYPE_EOE, response);
        let address = rest.get(3..).and_then(address_of);
        if let Some((mac, ip)) = address.filter(|_| kind & 0x0F == EOE_SET_IP) {
            let frame = gratuitous_arp(mac, ip);
            let blocks = u16::try_from(frame.len().div_ceil(32)).unwrap_or(0);
            let mut fragment = vec![EOE_FRAGMENT, EOE_LAST];
            // Fragment 0, the whole frame's length in blocks of 32 bytes, frame 0.
            fragment.extend((blocks << 6).to_le_bytes());
            fragment.extend(frame);
            self.queue_new(TYPE_EOE, fragment);
        }
    }

    fn reply_error(&mut self, error: MailError) {
        let mut payload = vec![1, 0];
        payload.extend((error as u16).to_le_bytes());
        self.queue_new(TYPE_ERROR, payload);
    }

    fn queue_new(&mut self, kind: u8, payload: Vec<u8>) {
        self.queue.push_back(Outgoing::New { kind, payload });
    }

    /// Puts the first queued message when the last one was read.
    fn send<P: Post>(&mut self, post: &mut P) {
        if self.waiting.is_some() || post.waits() {
            return;
        }
        let counter = self.last_sent % 7 + 1;
        let (mail, is_new) = match self.queue.front() {
            None => return,
            Some(Outgoing::Again(mail)) => (mail.clone(), false),
            Some(Outgoing::New { kind, payload }) => (compose(*kind, counter, payload), true),
        };
        if post.put(&mail) {
            self.queue.pop_front();
            self.emergencies = self.emergencies.saturating_sub(1);
            if is_new {
                self.last_sent = counter;
            }
            self.waiting = Some(mail);
        }
    }
}

/// The addresses that a request of EoE sets: flags, three bytes unused, then what is flagged.
fn address_of(parameters: &[u8]) -> Option<([u8; 6], [u8; 4])> {
    let (head, values) = parameters.split_first_chunk::<4>()?;
    let needed = EOE_HAS_MAC | EOE_HAS_IP;
    if head[0] & needed != needed {
        return None;
    }
    let (mac, values) = values.split_first_chunk()?;
    Some((*mac, *values.first_chunk()?))
}

/// The Ethernet frame by which a host says that it has this address (RFC 826, RFC 5227), filled up to 60 bytes.
fn gratuitous_arp(mac: [u8; 6], ip: [u8; 4]) -> Vec<u8> {
    let mut frame = vec![0xFF; 6];
    frame.extend(mac);
    frame.extend([0x08, 0x06, 0, 1, 0x08, 0, 6, 4, 0, 1]);
    frame.extend(mac);
    frame.extend(ip);
    frame.extend([0; 6]);
    frame.extend(ip);
    frame.resize(60, 0);
    frame
}

fn compose(kind: u8, counter: u8, payload: &[u8]) -> Vec<u8> {
    let length = u16::try_from(payload.len()).unwrap_or(u16::MAX);
    let mut mail = length.to_le_bytes().to_vec();
    mail.extend([0, 0, 0, kind | counter << 4]);
    mail.extend(payload);
    mail
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two sync managers as plain fields.
    #[derive(Default)]
    struct Slots {
        to_device: Option<Vec<u8>>,
        to_master: Option<Vec<u8>>,
        requested: bool,
        acknowledged: bool,
    }

    impl Post for Slots {
        fn take(&mut self) -> Option<Vec<u8>> {
            self.to_device.take()
        }
        fn waits(&self) -> bool {
            self.to_master.is_some()
        }
        fn put(&mut self, mail: &[u8]) -> bool {
            self.to_master = Some(mail.to_vec());
            true
        }
        fn withdraw(&mut self) {
            self.to_master = None;
        }
        fn repeat_is_requested(&self) -> bool {
            self.requested != self.acknowledged
        }
        fn acknowledge_repeat(&mut self) {
            self.acknowledged = self.requested;
        }
    }

    struct Dialogue {
        mailbox: Mailbox,
        slots: Slots,
        served: Vec<Vec<u8>>,
    }

    impl Dialogue {
        fn new() -> Self {
            Self {
                mailbox: Mailbox::default(),
                slots: Slots::default(),
                served: Vec::new(),
            }
        }

        fn poll(&mut self, now: Duration) {
            let served = &mut self.served;
            self.mailbox.poll(&mut self.slots, now, |payload| {
                served.push(payload.to_vec());
                Ok(vec![payload.to_vec()])
            });
        }

        fn send(&mut self, mail: &[u8]) {
            self.slots.to_device = Some(mail.to_vec());
            self.poll(Duration::ZERO);
        }

        fn read(&mut self) -> Option<Vec<u8>> {
            let mail = self.slots.to_master.take();
            self.poll(Duration::ZERO);
            mail
        }
    }

    #[test]
    fn replies_are_numbered_from_one_to_seven_and_round_again() {
        let mut talk = Dialogue::new();
        let mut counters = Vec::new();
        for counter in (1..=7).chain(1..=2) {
            talk.send(&[1, 0, 0, 0, 0, counter << 4 | 3, 0xAA]);
            counters.push(talk.read().unwrap()[5] >> 4);
        }
        assert_eq!(counters, [1, 2, 3, 4, 5, 6, 7, 1, 2]);
    }

    #[test]
    fn a_request_with_the_counter_of_the_last_one_is_dropped() {
        let mut talk = Dialogue::new();
        talk.send(&[1, 0, 0, 0, 0, 0x13, 0xAA]);
        assert!(talk.read().is_some());
        talk.send(&[1, 0, 0, 0, 0, 0x13, 0xAA]);
        assert_eq!(talk.read(), None);
        assert_eq!(talk.served.len(), 1);
    }

    #[test]
    fn counter_zero_is_never_a_repeat() {
        let mut talk = Dialogue::new();
        talk.send(&[1, 0, 0, 0, 0, 0x03, 0xAA]);
        talk.read();
        talk.send(&[1, 0, 0, 0, 0, 0x03, 0xAA]);
        assert_eq!(talk.served.len(), 2);
    }

    #[test]
    fn a_repeat_request_brings_the_last_message_again_before_the_next() {
        let mut talk = Dialogue::new();
        talk.send(&[1, 0, 0, 0, 0, 0x13, 0xAA]);
        let first = talk.read().unwrap();
        talk.send(&[1, 0, 0, 0, 0, 0x23, 0xBB]);
        talk.slots.requested = true;
        talk.poll(Duration::ZERO);
        assert!(talk.slots.acknowledged);
        assert_eq!(talk.read().unwrap(), first);
        let second = talk.read().unwrap();
        assert_eq!((second[5] >> 4, second[6]), (2, 0xBB));
    }

    #[test]
    fn emergencies_overtake_replies_in_their_own_order() {
        let mut talk = Dialogue::new();
        talk.send(&[1, 0, 0, 0, 0, 0x13, 0xAA]);
        talk.slots.to_device = Some(vec![1, 0, 0, 0, 0, 0x23, 0xBB]);
        talk.poll(Duration::ZERO);
        talk.mailbox.push_emergency(vec![1]);
        talk.mailbox.push_emergency(vec![2]);
        let order: Vec<u8> = core::iter::from_fn(|| talk.read())
            .map(|mail| mail[6])
            .collect();
        assert_eq!(order, [0xAA, 1, 2, 0xBB]);
    }

    #[test]
    fn a_reply_comes_after_the_delay_and_not_before() {
        let mut talk = Dialogue::new();
        talk.mailbox.delay = Duration::from_millis(5);
        talk.send(&[1, 0, 0, 0, 0, 0x13, 0xAA]);
        talk.poll(Duration::from_millis(4));
        assert!(talk.slots.to_master.is_none());
        talk.poll(Duration::from_millis(5));
        assert!(talk.slots.to_master.is_some());
    }

    #[test]
    fn an_address_that_is_set_is_acknowledged_and_announced() {
        let mut talk = Dialogue::new();
        talk.mailbox.protocols = SERVES_EOE;
        let (mac, ip) = ([0x02, 1, 2, 3, 4, 5], [192, 168, 1, 7]);
        let mut mail = vec![18, 0, 0, 0, 0, 0x12, 0x02, 0x01, 0, 0, 0x03, 0, 0, 0];
        mail.extend(mac);
        mail.extend(ip);
        talk.send(&mail);
        let response = talk.read().unwrap();
        assert_eq!(response, [4, 0, 0, 0, 0, 0x12, 0x03, 0x01, 0, 0]);
        let announced = talk.read().unwrap();
        assert_eq!(announced[..6], [64, 0, 0, 0, 0, 0x22]);
        // The last fragment of a frame of two blocks of 32 bytes.
        assert_eq!(announced[6..10], [0x00, 0x01, 0x80, 0x00]);
        assert_eq!(announced[10..16], [0xFF; 6]);
        assert_eq!(announced[16..22], mac);
        assert_eq!(announced[38..42], ip, "who has it");
        assert_eq!(announced[48..52], ip, "whom it asks for");
        assert_eq!(talk.read(), None);
    }

    #[test]
    fn a_file_is_not_there_and_a_frame_is_not_answered() {
        let mut talk = Dialogue::new();
        talk.mailbox.protocols = SERVES_EOE | SERVES_FOE;
        talk.send(&[7, 0, 0, 0, 0, 0x14, 1, 0, 0, 0, 0, 0, b'x']);
        assert_eq!(talk.read().unwrap()[6..], [5, 0, 0x01, 0x80, 0, 0]);
        talk.send(&[4, 0, 0, 0, 0, 0x22, 0, 1, 0, 0]);
        assert_eq!(talk.read(), None);
    }

    #[test]
    fn wrong_messages_are_answered_with_their_error() {
        let mut talk = Dialogue::new();
        talk.send(&[1, 0, 0, 0, 0, 0x14, 0]);
        assert_eq!(talk.read().unwrap()[6..], [1, 0, 2, 0]);
        talk.send(&[200, 0, 0, 0, 0, 0x23, 0]);
        assert_eq!(talk.read().unwrap()[6..], [1, 0, 8, 0]);
    }
}
