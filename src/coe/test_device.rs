//! A scripted device with a mailbox, in memory and in virtual time: the other end of the client's tests.
//! Its SDO server is written from the standard's tables and shares nothing with the codec.

use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, VecDeque};
use std::future::{Future, pending, poll_fn};
use std::rc::Rc;
use std::task::{Poll, Waker};
use std::time::Duration;

use super::{
    Clock, DriveId, Emergencies, LinkFault, MailboxClient, MailboxSettings, MailboxSignal,
    MailboxStatus, MailboxTransport, SdoHandle,
};
use crate::sii::{Identity, Mailbox, Protocols};

/// What happens to one access on its way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fault {
    /// The frame is lost before it reaches the device.
    LostBefore,
    /// The device acts on it; the frame is lost on its way back.
    LostAfter,
    /// The frame was sent twice: the answer is that of the second.
    Twice,
}

/// Time that moves only when nothing else can.
#[derive(Clone, Default)]
pub(crate) struct VirtualClock(Rc<ClockState>);

#[derive(Default)]
struct ClockState {
    now: Cell<Duration>,
    sleepers: RefCell<Vec<(Duration, Waker)>>,
}

impl VirtualClock {
    /// Moves to the next moment for which something sleeps; `false` if nothing does.
    fn advance(&self) -> bool {
        let mut sleepers = self.0.sleepers.borrow_mut();
        let Some(next) = sleepers.iter().map(|(until, _)| *until).min() else {
            return false;
        };
        self.0.now.set(next.max(self.0.now.get()));
        let (due, later) = sleepers.drain(..).partition(|(until, _)| *until <= next);
        *sleepers = later;
        let due: Vec<_> = due;
        due.into_iter().for_each(|(_, waker)| waker.wake());
        true
    }
}

impl Clock for VirtualClock {
    fn now(&self) -> Duration {
        self.0.now.get()
    }

    async fn sleep_until(&self, time: Duration) {
        poll_fn(|context| {
            if self.now() >= time {
                return Poll::Ready(());
            }
            let waker = context.waker().clone();
            self.0.sleepers.borrow_mut().push((time, waker));
            Poll::Pending
        })
        .await;
    }
}

/// Index and subindex.
type Address = (u16, u8);

/// The device; clones are the same one.
#[derive(Clone)]
pub(crate) struct Device(pub(crate) Rc<RefCell<DeviceState>>);

pub(crate) struct DeviceState {
    clock: VirtualClock,
    /// The object dictionary.
    pub objects: BTreeMap<(u16, u8), Vec<u8>>,
    /// Objects that cannot be written, and the abort code for it.
    pub refused: BTreeMap<(u16, u8), u32>,
    /// Objects that keep their value though a write to them is confirmed.
    pub stubborn: Vec<(u16, u8)>,
    /// An object, and what another one holds once it was written.
    pub set_back: Option<(Address, (Address, Vec<u8>))>,
    /// Every write that was carried out, in order.
    pub written: Vec<(u16, u8, Vec<u8>)>,
    /// Every SDO request that was served.
    pub served: usize,
    /// What happens to the accesses from now on, in order; then nothing.
    pub faults: VecDeque<Option<Fault>>,
    /// Accesses so far.
    pub accesses: usize,
    /// How long the next replies take, in order; then none.
    pub delays: VecDeque<Duration>,
    /// Mails put before the next reply.
    pub before_reply: Vec<Vec<u8>>,
    /// The fragments of the next answers to SDO information, in order; then the service is refused.
    pub information: VecDeque<Vec<Vec<u8>>>,
    /// The next replies that are not sent.
    pub swallow: usize,
    /// A message that is there whenever the mailbox is looked at.
    pub flood: Option<Vec<u8>>,
    /// Requests are taken from this moment on.
    pub takes_from: Duration,
    /// A request with the counter of the one before is served like any other.
    pub ignores_counter: bool,
    /// Its own messages have the counter 0.
    pub counts_nothing: bool,
    /// It is cut off: frames come back, and it has not answered them.
    pub absent: bool,
    /// No frame can be sent meanwhile: all slots are taken.
    pub busy: core::ops::Range<Duration>,
    /// When it last was so, and how often at that moment.
    busy_at: (Duration, usize),
    request: Option<Vec<u8>>,
    last_counter: u8,
    reply_counter: u8,
    outbox: VecDeque<(Duration, Vec<u8>)>,
    last_read: Option<Vec<u8>>,
    repeat: bool,
    upload: Vec<u8>,
    download: (u16, u8, usize, Vec<u8>),
}

/// Bytes of both mailboxes.
const MAILBOX: usize = 32;

/// A client and its device, ready to run.
pub(crate) fn rig() -> (Rig, Device, SdoHandle, Emergencies) {
    rig_with(|_| {})
}

/// The same with other settings.
pub(crate) fn rig_with(
    change: impl FnOnce(&mut MailboxSettings),
) -> (Rig, Device, SdoHandle, Emergencies) {
    let clock = VirtualClock::default();
    let device = Device(Rc::new(RefCell::new(DeviceState::new(clock.clone()))));
    let mailbox = Mailbox {
        receive_offset: 0x1000,
        receive_length: MAILBOX as u16,
        send_offset: 0x1400,
        send_length: MAILBOX as u16,
        protocols: Protocols(4),
    };
    let mut settings = MailboxSettings {
        emergency_capacity: 3,
        ..MailboxSettings::new(&mailbox)
    };
    change(&mut settings);
    let drive = DriveId {
        position: 3,
        name: "x".into(),
        identity: Identity::default(),
    };
    let (client, handle, emergencies) =
        MailboxClient::new(device.clone(), clock.clone(), settings, drive);
    let signal = client.signal();
    let executor = smol::LocalExecutor::new();
    executor.spawn(client.run()).detach();
    let rig = Rig {
        clock,
        signal,
        executor,
    };
    (rig, device, handle, emergencies)
}

/// Runs futures beside the client in virtual time.
pub(crate) struct Rig {
    pub clock: VirtualClock,
    /// Tells the client what a bus loop sees of the mailbox.
    pub signal: MailboxSignal,
    executor: smol::LocalExecutor<'static>,
}

impl Rig {
    /// Runs `future` to its end.
    pub fn run<R: 'static>(&self, future: impl Future<Output = R> + 'static) -> R {
        let task = self.executor.spawn(future);
        let mut turns = 0;
        loop {
            while self.executor.try_tick() {}
            if task.is_finished() {
                return smol::block_on(task);
            }
            assert!(self.clock.advance(), "everything waits for ever");
            turns += 1;
            assert!(turns < 1_000_000, "no end in sight");
        }
    }

    /// Lets time pass.
    pub fn pass(&self, duration: Duration) {
        let (clock, until) = (self.clock.clone(), self.clock.now() + duration);
        self.run(async move { clock.sleep_until(until).await });
    }
}

impl Device {
    pub fn set(&self, index: u16, subindex: u8, value: &[u8]) {
        let mut state = self.0.borrow_mut();
        state.objects.insert((index, subindex), value.to_vec());
    }

    /// Puts a message into the queue of those to be read.
    pub fn post(&self, message: &[u8]) {
        let mut state = self.0.borrow_mut();
        let now = state.clock.now();
        state.outbox.push_back((now, message.to_vec()));
    }

    async fn access<R>(&self, act: impl Fn(&mut DeviceState) -> R) -> Result<R, LinkFault> {
        let fault = {
            let mut state = self.0.borrow_mut();
            state.accesses += 1;
            if state.absent {
                return Err(LinkFault::NotAnswered);
            }
            let now = state.clock.now();
            if state.busy.contains(&now) {
                let (at, count) = state.busy_at;
                let count = if at == now { count + 1 } else { 1 };
                state.busy_at = (now, count);
                assert!(count < 100, "no pause between two accesses");
                return Err(LinkFault::Busy);
            }
            state.faults.pop_front().flatten()
        };
        if fault == Some(Fault::LostBefore) {
            return pending().await;
        }
        let mut answer = act(&mut self.0.borrow_mut());
        match fault {
            Some(Fault::LostAfter) => return pending().await,
            Some(Fault::Twice) => answer = act(&mut self.0.borrow_mut()),
            _ => {}
        }
        Ok(answer)
    }
}

impl MailboxTransport for Device {
    async fn write_message(&self, message: &[u8]) -> Result<bool, LinkFault> {
        assert!(message.len() <= MAILBOX);
        match self.access(|state| state.accept(message)).await {
            Err(LinkFault::NotAnswered) => Ok(false),
            taken => taken,
        }
    }

    async fn read_message(&self, message: &mut [u8]) -> Result<bool, LinkFault> {
        let read = match self.access(DeviceState::fetch).await {
            Err(LinkFault::NotAnswered) => None,
            read => read?,
        };
        for (to, from) in message.iter_mut().zip(read.iter().flatten()) {
            *to = *from;
        }
        Ok(read.is_some())
    }

    async fn status(&self) -> Result<MailboxStatus, LinkFault> {
        self.access(DeviceState::status).await
    }

    async fn request_repeat(&self, toggle: bool) -> Result<(), LinkFault> {
        self.access(|state| state.repeat(toggle)).await
    }
}

impl DeviceState {
    fn new(clock: VirtualClock) -> Self {
        Self {
            clock,
            objects: BTreeMap::from([((0x1000, 0), vec![0x92, 0x01, 0x02, 0x00])]),
            refused: BTreeMap::new(),
            stubborn: Vec::new(),
            set_back: None,
            written: Vec::new(),
            served: 0,
            faults: VecDeque::new(),
            accesses: 0,
            delays: VecDeque::new(),
            before_reply: Vec::new(),
            information: VecDeque::new(),
            swallow: 0,
            flood: None,
            takes_from: Duration::ZERO,
            ignores_counter: false,
            counts_nothing: false,
            absent: false,
            busy: Duration::ZERO..Duration::ZERO,
            busy_at: (Duration::ZERO, 0),
            request: None,
            last_counter: 0,
            reply_counter: 0,
            outbox: VecDeque::new(),
            last_read: None,
            repeat: false,
            upload: Vec::new(),
            download: (0, 0, 0, Vec::new()),
        }
    }

    /// It has been in INIT: its mailbox is empty, and counts begin again.
    pub fn begin_anew(&mut self) {
        self.request = None;
        self.last_counter = 0;
        self.reply_counter = 0;
        self.outbox.clear();
        self.last_read = None;
        self.repeat = false;
    }

    fn accept(&mut self, message: &[u8]) -> bool {
        self.work();
        if self.request.is_some() {
            return false;
        }
        self.request = Some(message.to_vec());
        true
    }

    fn fetch(&mut self) -> Option<Vec<u8>> {
        if let Some(message) = &self.flood {
            return Some(message.clone());
        }
        self.work();
        let now = self.clock.now();
        self.outbox.front().filter(|(ready, _)| *ready <= now)?;
        let (_, message) = self.outbox.pop_front()?;
        self.last_read = Some(message.clone());
        Some(message)
    }

    pub fn status(&mut self) -> MailboxStatus {
        self.work();
        let now = self.clock.now();
        MailboxStatus {
            request_pending: self.request.is_some(),
            message_waiting: self.flood.is_some()
                || self.outbox.front().is_some_and(|(ready, _)| *ready <= now),
            repeat_requested: self.repeat,
            repeat_done: self.repeat,
        }
    }

    /// The message read last is put in front again, unless the one in the mailbox has not been read at all.
    fn repeat(&mut self, toggle: bool) {
        if toggle != self.repeat {
            self.repeat = toggle;
            let now = self.clock.now();
            if let Some(message) = self.last_read.clone() {
                self.outbox.push_front((now, message));
            }
        }
    }

    /// Takes the request out of the mailbox and answers it.
    fn work(&mut self) {
        let now = self.clock.now();
        if now < self.takes_from {
            return;
        }
        let Some(message) = self.request.take() else {
            return;
        };
        let counter = message[5] >> 4;
        if counter == self.last_counter && !self.ignores_counter {
            return;
        }
        self.last_counter = counter;
        self.served += 1;
        if message[7] >> 4 == 8 {
            return self.inform();
        }
        let length = usize::from(u16::from_le_bytes([message[0], message[1]]));
        let reply = self.serve(&message[8..6 + length]);
        for message in std::mem::take(&mut self.before_reply) {
            self.outbox.push_back((now, message));
        }
        let Some(sdo) = reply else { return };
        if self.swallow > 0 {
            self.swallow -= 1;
            return;
        }
        if !self.counts_nothing {
            self.reply_counter = self.reply_counter % 7 + 1;
        }
        let ready = now + self.delays.pop_front().unwrap_or_default();
        let mut message = ((sdo.len() + 2) as u16).to_le_bytes().to_vec();
        // An abort travels as an SDO request.
        let service = if sdo[0] == 0x80 { 0x20 } else { 0x30 };
        message.extend([0, 0, 0, 3 | self.reply_counter << 4, 0, service]);
        message.extend(sdo);
        self.outbox.push_back((ready, message));
    }

    /// Puts the scripted answer to a question, or a mailbox error: service not supported.
    fn inform(&mut self) {
        let now = self.clock.now();
        let ready = now + self.delays.pop_front().unwrap_or_default();
        let Some(fragments) = self.information.pop_front() else {
            let error = vec![4, 0, 0, 0, 0, 0, 1, 0, 4, 0];
            return self.outbox.push_back((ready, error));
        };
        for fragment in fragments {
            self.reply_counter = self.reply_counter % 7 + 1;
            let mut message = ((fragment.len() + 2) as u16).to_le_bytes().to_vec();
            message.extend([0, 0, 0, 3 | self.reply_counter << 4, 0, 0x80]);
            message.extend(fragment);
            self.outbox.push_back((ready, message));
        }
    }

    fn serve(&mut self, sdo: &[u8]) -> Option<Vec<u8>> {
        let (index, subindex) = (u16::from_le_bytes([sdo[1], sdo[2]]), sdo[3]);
        let head = |command: u8| vec![command, sdo[1], sdo[2], sdo[3]];
        let abort = |code: u32| [head(0x80), code.to_le_bytes().to_vec()].concat();
        match sdo[0] >> 5 {
            2 => {
                let Some(value) = self.objects.get(&(index, subindex)) else {
                    return Some(abort(0x0602_0000));
                };
                if (1..=4).contains(&value.len()) {
                    let mut reply = head(0x43 | (4 - value.len() as u8) << 2);
                    reply.extend(value);
                    reply.resize(8, 0);
                    return Some(reply);
                }
                let now = value.len().min(MAILBOX - 16);
                let mut reply = head(0x41);
                reply.extend((value.len() as u32).to_le_bytes());
                reply.extend(&value[..now]);
                self.upload = value[now..].to_vec();
                Some(reply)
            }
            3 => {
                let now = self.upload.len().min(MAILBOX - 9);
                let part: Vec<u8> = self.upload.drain(..now).collect();
                let unused = 7usize.saturating_sub(part.len());
                let last = u8::from(self.upload.is_empty());
                let mut reply = vec![sdo[0] & 0x10 | (unused as u8) << 1 | last];
                reply.extend(part);
                reply.resize(reply.len() + unused, 0);
                Some(reply)
            }
            1 => {
                if let Some(code) = self.refused.get(&(index, subindex)) {
                    return Some(abort(*code));
                }
                if sdo[0] & 2 != 0 {
                    let value = sdo[4..8 - usize::from(sdo[0] >> 2 & 3)].to_vec();
                    self.store(index, subindex, value);
                } else {
                    let size = u32::from_le_bytes([sdo[4], sdo[5], sdo[6], sdo[7]]) as usize;
                    self.download = (index, subindex, size, Vec::new());
                    self.append(&sdo[8..]);
                }
                Some([head(0x60), vec![0; 4]].concat())
            }
            0 => {
                let unused = if sdo.len() == 8 {
                    usize::from(sdo[0] >> 1 & 7)
                } else {
                    0
                };
                self.append(&sdo[1..sdo.len() - unused]);
                Some(vec![0x20 | sdo[0] & 0x10, 0, 0, 0, 0, 0, 0, 0])
            }
            _ => None,
        }
    }

    fn append(&mut self, data: &[u8]) {
        self.download.3.extend(data);
        let (index, subindex, size, value) = self.download.clone();
        if value.len() == size {
            self.store(index, subindex, value);
        }
    }

    fn store(&mut self, index: u16, subindex: u8, value: Vec<u8>) {
        if !self.stubborn.contains(&(index, subindex)) {
            self.objects.insert((index, subindex), value.clone());
        }
        if let Some((written, (object, held))) = &self.set_back
            && *written == (index, subindex)
        {
            self.objects.insert(*object, held.clone());
        }
        self.written.push((index, subindex, value));
    }
}

/// An emergency message with this error code.
pub(crate) fn emergency(code: u16) -> Vec<u8> {
    let [low, high] = code.to_le_bytes();
    vec![
        10, 0, 0, 0, 0, 0x03, 0, 0x10, low, high, 0x21, 1, 2, 3, 4, 5,
    ]
}
