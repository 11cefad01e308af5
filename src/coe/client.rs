//! The mailbox client: one actor per device, which alone touches its mailbox, on the thread that owns the bus.
//!
//! Transfers run one after another. A message whose reading is lost is asked for again by the repeat request. A request whose frame
//! is lost is sent again with the same mailbox counter, by which the device knows it. A request that writes an object is never sent
//! again, since a device that does not look at the counter would write twice: see `unconfirmed`.
//!
//! Its messages have their memory from the beginning. All else that a transfer takes comes with its call (`calls`) and goes back
//! with the answer.

#[cfg(test)]
mod tests;

mod notes;

use alloc::string::ToString;
use alloc::sync::Arc;
use alloc::vec;
use alloc::vec::Vec;
use core::future::{Future, poll_fn};
use core::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use core::task::Poll;
use core::time::Duration;

use atomic_waker::AtomicWaker;
use smol::future::or;

use super::emergencies::{Emergencies, EmergencyQueue, Received};
use super::emergency::Emergency;
use super::error::AbortCode;
use super::error::{DriveId, ErrorTexts, NoInformation, SdoError, SdoStep, Transfer};
use super::handle::{
    Answer, Call, RemoteRequest, Request, RequestReceiver, SdoHandle, Served, Server, calls,
};
use super::information::{Inquiry, Question};
use super::mailbox::{
    Counter, HEADER_LENGTH, MailboxError, MailboxMessage, SHORTEST_MAILBOX, information_message,
    sdo_message,
};
use super::obj;
use super::object::ObjectAddress;
use super::sdo::{Download, SdoFault, TransferStep, Upload, abort_request};
use super::transport::{LinkFault, MailboxStatus, MailboxTransport};
use crate::sii::{Mailbox, Sii};
use crate::wakes::Waiters;
use notes::{Excerpt, MailboxEvent};
pub(crate) use notes::{MailboxLog, MailboxRecord};

/// Messages read in a row before deadlines and requests get their turn: a device may send without end.
const MAILS_AT_ONCE: usize = 16;

/// The time that the actor goes by.
pub trait Clock {
    /// The present, since an arbitrary epoch.
    fn now(&self) -> Duration;

    /// Resolves at `time`.
    fn sleep_until(&self, time: Duration) -> impl Future<Output = ()>;
}

/// The actor of one device's mailbox; see [`MailboxClient::run`].
pub struct MailboxClient<T, C> {
    transport: T,
    clock: C,
    settings: MailboxSettings,
    drive: Arc<DriveId>,
    calls: RequestReceiver,
    /// The place of the call that is served.
    served: Option<Served>,
    emergencies: EmergencyQueue,
    /// Where those of all drives of a network go.
    of_network: Option<EmergencyQueue>,
    texts: Arc<ErrorTexts>,
    /// Who takes what is to be logged; nobody: then it is written at once.
    notes: Option<MailboxLog>,
    signal: MailboxSignal,
    counters: Counters,
    /// The message that is being sent.
    request: Vec<u8>,
    /// What was read, as long as the mailbox.
    reply: Vec<u8>,
    /// What was read last, as long as its message says.
    last: Vec<u8>,
    /// The value of an object that was read for the answer's sake.
    other: Vec<u8>,
    /// A message was asked for again: the next one may be the last one once more.
    repeated: bool,
    /// Transfers whose replies may still come.
    owed: Vec<Transfer>,
    /// A request was sent again, so that a second reply may come from a device that does not look at the counter.
    sent_again: bool,
    /// An error reply that may be an earlier request's.
    refusal: Option<MailboxError>,
    unconfirmed: UnconfirmedWrite,
    /// The device has been in INIT since the present transfer began: it may have forgotten an answer.
    forgets: bool,
    poll_timing: PollTiming,
    /// Accesses that failed in a row.
    failures: u32,
}

/// What the client does next.
enum ClientAction {
    /// Serve a call; end, if there can be none any more.
    Call(Option<Call>),
    /// Look at the mailbox; whether a message is known to wait.
    Due(bool),
}

/// What a look at the device's mailbox brought.
enum Found {
    Nothing,
    /// A message that answers nothing: an emergency, a late reply.
    Other,
    Answer(TransferStep),
}

impl<T: MailboxTransport, C: Clock> MailboxClient<T, C> {
    /// A client for the drive `drive`, with its handle and its emergencies.
    pub fn new(
        transport: T,
        clock: C,
        settings: MailboxSettings,
        drive: DriveId,
    ) -> (Self, SdoHandle, Emergencies) {
        let capacities = (settings.request_capacity, settings.emergency_capacity);
        let (unserved, sdo, emergencies) = UnservedMailbox::new(capacities, drive, Waiters::direct);
        let client = Self::serving(unserved, transport, clock, settings);
        (client, sdo, emergencies)
    }

    /// A client that serves this mailbox.
    pub(crate) fn serving(
        unserved: UnservedMailbox,
        transport: T,
        clock: C,
        settings: MailboxSettings,
    ) -> Self {
        let UnservedMailbox {
            drive,
            calls,
            emergencies,
            signal,
        } = unserved;
        calls.begin(settings);
        let read_length = settings.read_length.max(SHORTEST_MAILBOX);
        Self {
            drive,
            transport,
            clock,
            settings,
            calls,
            served: None,
            emergencies,
            of_network: None,
            texts: Arc::default(),
            notes: None,
            signal,
            counters: Counters::default(),
            request: Vec::with_capacity(settings.write_length.max(SHORTEST_MAILBOX)),
            reply: vec![0; read_length],
            last: Vec::with_capacity(read_length),
            other: Vec::with_capacity(read_length),
            repeated: false,
            forgets: false,
            owed: Vec::with_capacity(MOST_OWED),
            sent_again: false,
            refusal: None,
            unconfirmed: UnconfirmedWrite::default(),
            poll_timing: PollTiming::default(),
            failures: 0,
        }
    }

    /// The same client for a drive whose error codes mean this.
    #[must_use]
    pub fn with_error_texts(mut self, texts: impl Into<Arc<ErrorTexts>>) -> Self {
        self.texts = texts.into();
        self
    }

    /// The same client, whose emergencies go into this queue too.
    pub(crate) fn reporting_to(mut self, of_network: EmergencyQueue) -> Self {
        self.of_network = Some(of_network);
        self
    }

    /// The same client, whose notes for the log are taken by this.
    pub(crate) fn noting_to(mut self, notes: MailboxLog) -> Self {
        self.notes = Some(notes);
        self
    }

    /// By which a bus loop reports what it sees of the mailbox: then the client does not look while nothing is due.
    #[cfg(test)]
    pub(crate) fn signal(&self) -> MailboxSignal {
        self.signal.clone()
    }

    /// Serves the handles, and collects emergencies, until the last handle is dropped.
    pub async fn run(mut self) {
        loop {
            let next = or(
                async { ClientAction::Call(self.calls.next().await) },
                async { ClientAction::Due(self.something_due().await) },
            );
            match next.await {
                ClientAction::Due(message_waits) => self.collect(message_waits).await,
                ClientAction::Call(Some(call)) => {
                    self.serve(call).await;
                    self.signal.forget();
                }
                ClientAction::Call(None) => return,
            }
        }
    }

    /// Waits until the mailbox is to be looked at though nothing was asked for. Whether a message is known to wait.
    async fn something_due(&self) -> bool {
        if self.signal.is_watched() {
            return self.signal.message_waits().await;
        }
        let next = self.clock.now().saturating_add(self.settings.idle_interval);
        self.clock.sleep_until(next).await;
        false
    }

    async fn serve(&mut self, call: Call) {
        let Call { mut request, place } = call;
        self.served = Some(place);
        // Nobody waits any more and nothing was sent: withdrawn, and nobody looks at the result.
        let result = if self.is_left() {
            Ok(())
        } else {
            self.transfer(&mut request).await
        };
        let dialogue = request.dialogue;
        // A caller that went away meanwhile misses its result; the mailbox is in order.
        if let Some(place) = self.served.take() {
            self.calls.answer(place, Answer { dialogue, result });
        }
    }

    /// Whether nobody waits any more for the transfer that is under way.
    fn is_left(&self) -> bool {
        self.served.as_ref().is_some_and(Served::is_left)
    }

    async fn transfer(&mut self, request: &mut Request) -> Result<(), Failure> {
        let (transfer, timeout) = (request.transfer, request.timeout);
        let dialogue = &mut request.dialogue;
        if dialogue.is_question() && !self.settings.sdo_information {
            return Err(Failure::NoService(NoInformation::Sii));
        }
        if self.owes_like(transfer) {
            self.resynchronise(transfer, timeout).await?;
        }
        self.forget_the_session_before();
        self.forgets = false;
        loop {
            match self.converse(dialogue, transfer, timeout).await {
                Err(Failure::Doubtful) => match self.settle(transfer, timeout).await? {
                    Settled::Written => return Ok(()),
                    Settled::NeverArrived => {}
                },
                result => return result,
            }
        }
    }

    /// Runs a transfer to its end.
    async fn converse(
        &mut self,
        dialogue: &mut Dialogue,
        transfer: Transfer,
        timeout: Duration,
    ) -> Result<(), Failure> {
        loop {
            match self.exchange(dialogue, transfer, timeout).await {
                Ok(TransferStep::Done) => {
                    self.answered(transfer);
                    return Ok(());
                }
                Ok(_) => {}
                Err(Failure::Doubtful) => return Err(Failure::Doubtful),
                Err(failure) => {
                    match failure {
                        Failure::Fault(SdoFault::Aborted(_)) => self.answered(transfer),
                        _ => self.remember_owed(transfer),
                    }
                    if dialogue.is_segmented()
                        && let Some(code) = failure.abort_code()
                    {
                        // A courtesy, so that the device drops its half of the transfer; without reply.
                        let abort = abort_request(transfer.object, code);
                        let counter = self.counters.next();
                        sdo_message(&mut self.request, counter, |message| {
                            message.extend_from_slice(&abort);
                        });
                        let _ = self.send().await;
                    }
                    return Err(failure);
                }
            }
        }
    }

    /// Sends the request that is due and waits for its reply.
    async fn exchange(
        &mut self,
        dialogue: &mut Dialogue,
        transfer: Transfer,
        timeout: Duration,
    ) -> Result<TransferStep, Failure> {
        let mut asked_at = self.clock.now();
        let mut deadline = asked_at.saturating_add(timeout);
        let mut left = false;
        self.failures = 0;
        self.refusal = None;
        let mut doubtful_from = None;
        // Further fragments of an answer come unasked.
        let mut sent = dialogue.waits_for() == SdoStep::Fragment;
        if !sent {
            let counter = self.counters.next();
            dialogue.compose(&mut self.request, counter);
            self.note(MailboxEvent::Request(transfer, Excerpt::of(&self.request)));
        }
        // The mailbox was empty when it was read without a look at its state: a frame that came twice may have read it.
        let mut perhaps_read = false;
        loop {
            if !sent && doubtful_from.is_none() {
                match self.send().await {
                    // A quick device has answered by now: its message is read without a look at the state before.
                    Ok(true) if self.poll_timing.is_quick() => {
                        sent = true;
                        asked_at = self.clock.now();
                        match self.read_unasked(dialogue).await? {
                            Found::Answer(step) => return Ok(step),
                            Found::Other => {}
                            Found::Nothing => perhaps_read = true,
                        }
                    }
                    Ok(true) => {
                        sent = true;
                        asked_at = self.clock.now();
                        let first = asked_at + self.poll_timing.first_look();
                        self.clock.sleep_until(first.min(deadline)).await;
                    }
                    Ok(false) => {}
                    Err(fault) => {
                        self.tolerate(fault)?;
                        if fault == LinkFault::Lost && dialogue.writes_at_once() {
                            doubtful_from = Some(self.clock.now() + LOOKED_FOR);
                        } else if fault == LinkFault::Lost {
                            self.sent_again = true;
                        }
                    }
                }
            }
            // Also before the request was taken. A device may not take one before its own message is read. A request whose frame
            // was lost on its way back may have been answered.
            for _ in 0..MAILS_AT_ONCE {
                match self.look(Some(dialogue)).await? {
                    Found::Answer(step) => {
                        self.poll_timing.answered_after(self.clock.now() - asked_at);
                        return Ok(step);
                    }
                    Found::Other => {}
                    Found::Nothing => break,
                }
            }
            // In INIT it has forgotten what it was to answer, however long that is waited for.
            if self.forget_the_session_before() && sent {
                return Err(Failure::NoReply);
            }
            let now = self.clock.now();
            // One that nobody waits for any more holds up the others no longer than any other does.
            if !left && self.is_left() {
                left = true;
                deadline = deadline.min(now.saturating_add(self.settings.reply_timeout));
            }
            if doubtful_from.is_some_and(|from| now >= from) {
                return Err(Failure::Doubtful);
            }
            if now >= deadline && core::mem::take(&mut perhaps_read) {
                self.ask_again().await?;
                continue;
            }
            if now >= deadline {
                return Err(match self.refusal.take() {
                    Some(error) => Failure::Refused(error),
                    None if sent => Failure::NoReply,
                    None => Failure::NotTaken,
                });
            }
            let pause = self
                .poll_timing
                .pause(now - asked_at, self.settings.poll_interval);
            self.clock.sleep_until((now + pause).min(deadline)).await;
        }
    }

    /// Puts the message that is due into the device's mailbox; `false` if that is full.
    async fn send(&mut self) -> Result<bool, LinkFault> {
        self.forget_the_session_before();
        let sent = self
            .access(self.transport.write_message(&self.request))
            .await;
        match sent {
            Ok(true) => self.counters.taken(),
            Ok(false) => {}
            Err(_) => self.counters.perhaps_taken(),
        }
        sent
    }

    /// Whether the device has been in INIT: what it said before says nothing about what it says now.
    fn forget_the_session_before(&mut self) -> bool {
        let begins_anew = self.signal.has_begun_anew();
        if begins_anew {
            self.repeated = false;
            self.last.clear();
            self.owed.clear();
            self.sent_again = false;
            self.forgets = true;
        }
        begins_anew
    }

    fn note(&self, event: MailboxEvent) {
        let drive = Arc::clone(&self.drive);
        let note = MailboxRecord { drive, event };
        match &self.notes {
            Some(notes) => notes(self.clock.now(), note),
            None => note.write(self.clock.now()),
        }
    }
}

// A mailbox whose device is not there yet: handles of it exist, and nobody serves them.

/// The client's end of a mailbox that is not served yet; transfers fail until then.
pub(crate) struct UnservedMailbox {
    drive: Arc<DriveId>,
    calls: RequestReceiver,
    emergencies: EmergencyQueue,
    signal: MailboxSignal,
}

impl UnservedMailbox {
    /// With the program's ends, for so many waiting requests and emergencies. The tasks that wait for these wait at `waiters`.
    pub fn new(
        (requests, emergencies): (usize, usize),
        drive: DriveId,
        waiters: impl Fn() -> Arc<Waiters>,
    ) -> (Self, SdoHandle, Emergencies) {
        let (callers, calls) = calls(requests, waiters());
        let (queue, emergencies) = EmergencyQueue::new(emergencies, waiters());
        let drive = Arc::new(drive);
        let unserved = Self {
            drive: Arc::clone(&drive),
            calls,
            emergencies: queue,
            signal: MailboxSignal::default(),
        };
        let sdo = SdoHandle {
            server: Server::Mailbox(Arc::new(callers)),
            drive,
            timeout: None,
        };
        (unserved, sdo, emergencies)
    }

    /// By which a bus loop reports what it sees of the mailbox: then the client does not look while nothing is due.
    pub fn signal(&self) -> MailboxSignal {
        self.signal.clone()
    }
}

// Settings of a mailbox client: lengths, deadlines, bounds.

/// Lengths, deadlines and bounds of a mailbox client.
///
/// ```
/// use core::time::Duration;
/// use servocrab::{coe::MailboxSettings, sii::{Mailbox, Protocols}};
///
/// // As a device's SII gives it.
/// let mailbox = Mailbox {
///     receive_offset: 0x1800,
///     receive_length: 1024,
///     send_offset: 0x1C00,
///     send_length: 1024,
///     protocols: Protocols(4), // CoE
/// };
/// let patient = MailboxSettings { reply_timeout: Duration::from_secs(5), ..MailboxSettings::new(&mailbox) };
/// assert_eq!(patient.read_length, 1024);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MailboxSettings {
    /// Bytes of the mailbox that the master writes.
    pub write_length: usize,
    /// Bytes of the mailbox that the master reads.
    pub read_length: usize,
    /// After this a frame counts as lost and its future is dropped.
    pub frame_timeout: Duration,
    /// After this the reading of a message counts as lost, and the message is asked for again by the repeat request. Shorter
    /// than the time for a frame, because the link must not send this one again: that would read the next message.
    pub read_timeout: Duration,
    /// After this a request without reply has failed; counted anew for each segment.
    pub reply_timeout: Duration,
    /// The longest time between two looks at a mailbox while a reply is due; the first ones follow each other sooner.
    pub poll_interval: Duration,
    /// The time between two looks at the mailbox while nothing is due, for emergencies. Not in the cycles of a `Network`, whose
    /// frames show what waits.
    pub idle_interval: Duration,
    /// Whether the device may be asked by SDO information: what its SII's CoE details say. If not, such questions fail as
    /// not supported, unasked.
    pub sdo_information: bool,
    /// Whether the device's SII says that it has complete access.
    pub complete_access: bool,
    /// How many accesses in a row may fail before a transfer is given up.
    pub attempts: u32,
    /// Requests that may wait.
    pub request_capacity: usize,
    /// Emergencies that are kept for a program that has not taken them.
    pub emergency_capacity: usize,
}

const REQUESTS: usize = 16;
const EMERGENCIES: usize = 64;

impl MailboxSettings {
    /// How many requests and how many emergencies may wait, where nobody sets anything else.
    pub(crate) const CAPACITIES: (usize, usize) = (REQUESTS, EMERGENCIES);

    /// The settings for the mailbox of a device with this SII, as [`MailboxSettings::new`].
    #[must_use]
    pub fn of(sii: &Sii, mailbox: &Mailbox) -> Self {
        let general = sii.general.as_ref();
        Self {
            sdo_information: general.is_none_or(|general| general.coe.sdo_information()),
            complete_access: general.is_some_and(|general| general.coe.complete_access()),
            ..Self::new(mailbox)
        }
    }

    /// The settings for a device's mailbox, with 1 s for a reply.
    #[must_use]
    pub fn new(mailbox: &Mailbox) -> Self {
        Self {
            write_length: usize::from(mailbox.receive_length),
            read_length: usize::from(mailbox.send_length),
            frame_timeout: Duration::from_millis(150),
            read_timeout: Duration::from_millis(40),
            reply_timeout: Duration::from_secs(1),
            poll_interval: Duration::from_micros(250),
            idle_interval: Duration::from_millis(10),
            sdo_information: true,
            complete_access: false,
            attempts: 5,
            request_capacity: REQUESTS,
            emergency_capacity: EMERGENCIES,
        }
    }
}

// Accesses to the mailbox with their deadlines, and the request for a message whose reading was lost.

impl<T: MailboxTransport, C: Clock> MailboxClient<T, C> {
    /// Asks the device for its last message once more and waits until it has followed.
    async fn repeat(&mut self, before: MailboxStatus) -> Result<(), Failure> {
        let toggle = !before.repeat_requested;
        let deadline = self.clock.now().saturating_add(self.settings.frame_timeout);
        self.repeated = true;
        while let Err(fault) = self.access(self.transport.request_repeat(toggle)).await {
            self.tolerate(fault)?;
            self.pause().await;
        }
        // A device that never follows has no repeat; what it sends next is read as usual.
        while self.clock.now() < deadline {
            match self.access(self.transport.status()).await {
                Ok(status) if status.repeat_done == toggle => break,
                Ok(_) => {}
                Err(fault) => self.tolerate(fault)?,
            }
            self.pause().await;
        }
        Ok(())
    }

    /// Asks the device for its last message once more, whatever its mailbox shows.
    async fn ask_again(&mut self) -> Result<(), Failure> {
        loop {
            match self.access(self.transport.status()).await {
                Ok(status) => return self.repeat(status).await,
                Err(fault) => self.tolerate(fault)?,
            }
            self.pause().await;
        }
    }

    async fn pause(&self) {
        let next = self.clock.now().saturating_add(self.settings.poll_interval);
        self.clock.sleep_until(next).await;
    }

    /// One access with its deadline.
    async fn access<R>(
        &self,
        access: impl Future<Output = Result<R, LinkFault>>,
    ) -> Result<R, LinkFault> {
        self.access_within(self.settings.frame_timeout, access)
            .await
    }

    async fn access_within<R>(
        &self,
        limit: Duration,
        access: impl Future<Output = Result<R, LinkFault>>,
    ) -> Result<R, LinkFault> {
        let deadline = self.clock.now().saturating_add(limit);
        or(access, async {
            self.clock.sleep_until(deadline).await;
            Err(LinkFault::Lost)
        })
        .await
    }

    /// Counts a failed access; too many in a row end the transfer.
    fn tolerate(&mut self, fault: LinkFault) -> Result<(), Failure> {
        if fault == LinkFault::Busy {
            return Ok(());
        }
        self.failures += 1;
        if self.failures >= self.settings.attempts {
            return Err(Failure::Link(fault));
        }
        Ok(())
    }
}

// Reading of messages: one at a time, to whom it concerns, and what waits while nothing was asked for.

impl<T: MailboxTransport, C: Clock> MailboxClient<T, C> {
    /// Reads away what waits while nothing was asked for.
    async fn collect(&mut self, mut message_waits: bool) {
        self.forget_the_session_before();
        // What failed before, a transfer say, does not count against what waits now.
        self.failures = 0;
        for _ in 0..MAILS_AT_ONCE {
            let found = if core::mem::take(&mut message_waits) {
                self.read_waiting().await
            } else {
                self.look(None).await
            };
            match found {
                Ok(Found::Other) => {}
                Ok(_) => break,
                Err(fault) => {
                    self.note(MailboxEvent::Unreadable(fault));
                    break;
                }
            }
        }
        self.signal.forget();
    }

    /// Reads one message, if there is one, and hands it to whom it concerns.
    async fn look(&mut self, dialogue: Option<&mut Dialogue>) -> Result<Found, Failure> {
        let status = match self.access(self.transport.status()).await {
            Ok(status) => status,
            Err(fault) => {
                self.tolerate(fault)?;
                return Ok(Found::Nothing);
            }
        };
        if !status.message_waiting {
            self.failures = 0;
            return Ok(Found::Nothing);
        }
        match self.read().await {
            Ok(true) => self.take(dialogue),
            // Empty although a message waited: a frame that was sent again has read it before.
            Ok(false) | Err(LinkFault::Lost) => {
                self.tolerate(LinkFault::Lost)?;
                self.repeat(status).await?;
                Ok(Found::Nothing)
            }
            Err(fault) => {
                self.tolerate(fault)?;
                Ok(Found::Nothing)
            }
        }
    }

    /// Reads the message that is known to wait while nothing was asked for.
    async fn read_waiting(&mut self) -> Result<Found, Failure> {
        match self.read().await {
            Ok(true) => self.take(None),
            // Empty although a message waited: a frame that came twice has read it before.
            Ok(false) | Err(LinkFault::Lost) => {
                self.tolerate(LinkFault::Lost)?;
                self.ask_again().await?;
                Ok(Found::Nothing)
            }
            Err(fault) => {
                self.tolerate(fault)?;
                Ok(Found::Nothing)
            }
        }
    }

    /// Reads one message, where there may be one, and hands it to whom it concerns.
    async fn read_unasked(&mut self, dialogue: &mut Dialogue) -> Result<Found, Failure> {
        match self.read().await {
            Ok(true) => self.take(Some(dialogue)),
            Ok(false) => Ok(Found::Nothing),
            // Whether a message was read by the frame that is lost, nobody knows.
            Err(LinkFault::Lost) => {
                self.tolerate(LinkFault::Lost)?;
                self.ask_again().await?;
                Ok(Found::Nothing)
            }
            Err(fault) => {
                self.tolerate(fault)?;
                Ok(Found::Nothing)
            }
        }
    }

    /// Reads the mailbox; false if it is empty.
    async fn read(&mut self) -> Result<bool, LinkFault> {
        let mut message = core::mem::take(&mut self.reply);
        message.fill(0);
        let reading = self.transport.read_message(&mut message);
        let read = self
            .access_within(self.settings.read_timeout, reading)
            .await;
        self.reply = message;
        if read == Ok(true) {
            self.failures = 0;
        }
        read
    }

    /// Takes the message that was read.
    fn take(&mut self, dialogue: Option<&mut Dialogue>) -> Result<Found, Failure> {
        let message = core::mem::take(&mut self.reply);
        let found = self.pass_on(&message, dialogue);
        self.reply = message;
        found
    }

    fn pass_on(
        &mut self,
        message: &[u8],
        dialogue: Option<&mut Dialogue>,
    ) -> Result<Found, Failure> {
        let (header, content) = match MailboxMessage::parse(message) {
            Ok(parsed) => parsed,
            Err(cut) if dialogue.is_some() => return Err(Failure::Fault(cut.into())),
            Err(cut) => {
                self.note(MailboxEvent::Cut(cut));
                return Ok(Found::Other);
            }
        };
        let whole = message
            .get(..HEADER_LENGTH + usize::from(header.length))
            .unwrap_or(message);
        // Without a counter, one that looks the same may be another answer. That to a write must not be taken for one of the write before.
        let told_apart = header.counter != 0 || matches!(dialogue, Some(Dialogue::Download(_)));
        let twice = self.repeated && told_apart && whole == self.last;
        self.repeated = false;
        if twice {
            return Ok(Found::Other);
        }
        self.last.clear();
        self.last.extend_from_slice(whole);
        match (content, dialogue) {
            (MailboxMessage::Emergency(emergency), _) => {
                self.report(emergency);
                Ok(Found::Other)
            }
            (
                content @ (MailboxMessage::SdoReply(_) | MailboxMessage::SdoInformation(_)),
                Some(dialogue),
            ) => match dialogue.feed(content, self.owed.is_empty())? {
                TransferStep::Foreign => {
                    if !self.unconfirmed.feed(content) {
                        self.note(MailboxEvent::Foreign(content.into()));
                    }
                    Ok(Found::Other)
                }
                step => Ok(Found::Answer(step)),
            },
            (MailboxMessage::Error(error), Some(_)) if self.owed.is_empty() => {
                Err(Failure::Refused(error))
            }
            // An error reply does not say which request it is for. If it was this one's, no other answer will come.
            (MailboxMessage::Error(error), Some(_)) => {
                self.refusal = Some(error);
                Ok(Found::Other)
            }
            (content, _) => {
                self.note(MailboxEvent::Unawaited(content.into()));
                Ok(Found::Other)
            }
        }
    }

    fn report(&self, emergency: Emergency) {
        self.note(MailboxEvent::Emergency(emergency, Arc::clone(&self.texts)));
        let received = Received {
            drive: Arc::clone(&self.drive),
            at: self.clock.now(),
            emergency,
            texts: Arc::clone(&self.texts),
        };
        if let Some(queue) = &self.of_network {
            queue.push(received.clone());
        }
        self.emergencies.push(received);
    }
}

// A write whose frame is lost: the device may have taken it, or never seen it, and its sync manager does not show which.
//
// It is not sent again before that is known: a command object must not be carried out twice. A device answers in order, so the
// client reads another object. If the write's own answer does not come before that one's, the write never arrived.

/// How long the answer is looked for before another object is read.
const LOOKED_FOR: Duration = Duration::from_millis(20);

/// What has become of an unconfirmed write.
enum Settled {
    Written,
    /// It can be sent again.
    NeverArrived,
}

/// An unconfirmed write while another object is read.
#[derive(Default)]
struct UnconfirmedWrite {
    /// In its place, and without its data, which were in the one message: it takes the same replies.
    write: Option<Dialogue>,
    answer: Option<Result<TransferStep, Failure>>,
}

impl UnconfirmedWrite {
    /// Takes a reply that is not the other object's. False if it is not the write's either.
    fn feed(&mut self, reply: MailboxMessage<'_>) -> bool {
        match self.write.as_mut().map(|write| write.feed(reply, false)) {
            None | Some(Ok(TransferStep::Foreign)) => false,
            Some(answer) => {
                self.answer = Some(answer);
                true
            }
        }
    }
}

impl<T: MailboxTransport, C: Clock> MailboxClient<T, C> {
    /// Finds out whether the device has taken the write.
    async fn settle(&mut self, transfer: Transfer, timeout: Duration) -> Result<Settled, Failure> {
        self.note(MailboxEvent::Doubtful(transfer));
        let other = self.another_object(transfer);
        self.remember_owed(transfer);
        let write = Download::new(transfer.object, Vec::new(), self.settings.write_length);
        self.unconfirmed.write = Some(Dialogue::Download(write));
        let answered = self.read_another(other, timeout).await;
        self.unconfirmed.write = None;
        match self.unconfirmed.answer.take() {
            Some(Ok(_)) => Ok(Settled::Written),
            Some(Err(failure)) => Err(failure),
            // One that was in INIT may have carried it out, and has forgotten to say so.
            None if answered && !self.forgets => Ok(Settled::NeverArrived),
            None => {
                self.remember_owed(transfer);
                Err(Failure::NoReply)
            }
        }
    }
}

// Replies that come after their transfer was given up: they must not answer another one.

/// Transfers that are remembered as owed their replies; with more of them any object may be meant.
const MOST_OWED: usize = 32;

impl<T: MailboxTransport, C: Clock> MailboxClient<T, C> {
    /// Notes that the reply to this transfer may still come.
    fn remember_owed(&mut self, transfer: Transfer) {
        if self.owed.len() < MOST_OWED && !self.owed.contains(&transfer) {
            self.owed.push(transfer);
        }
    }

    /// Whether a reply may still come that would pass for one to `transfer`.
    fn owes_like(&self, transfer: Transfer) -> bool {
        self.owed.len() >= MOST_OWED || self.owed.iter().any(|owed| owed.is_like(transfer))
    }

    /// An answer to this transfer has come. A device answers in order: nothing earlier is owed any more.
    fn answered(&mut self, transfer: Transfer) {
        self.owed.clear();
        if core::mem::take(&mut self.sent_again) {
            self.owed.push(transfer);
        }
    }

    /// An object whose reading is no answer to `transfer` or to what is owed.
    fn another_object(&self, transfer: Transfer) -> ObjectAddress {
        let others = [obj::DEVICE_TYPE, obj::VENDOR_ID, obj::PRODUCT_CODE].map(|o| o.address());
        let is_free = |other: &ObjectAddress| {
            let read = Transfer::read(*other);
            !read.is_like(transfer) && !self.owed.iter().any(|owed| owed.is_like(read))
        };
        // At most 32 are owed. An entry that is not there is refused by its address, which is an answer as well.
        let entries = (1..=u8::MAX).map(|subindex| ObjectAddress::new(0x1000, subindex));
        others
            .into_iter()
            .chain(entries)
            .find(is_free)
            .unwrap_or(others[0])
    }

    /// Waits out the late reply of an earlier transfer of the same object, which its address does not distinguish from this one's.
    /// A device answers in order: once it has answered about another object, nothing late comes.
    async fn resynchronise(
        &mut self,
        transfer: Transfer,
        timeout: Duration,
    ) -> Result<(), Failure> {
        let other = self.another_object(transfer);
        if self.read_another(other, timeout).await {
            Ok(())
        } else {
            Err(Failure::EarlierReply)
        }
    }

    /// Reads an object whose value does not matter; whether the device answered.
    async fn read_another(&mut self, other: ObjectAddress, timeout: Duration) -> bool {
        let upload = Upload::new(other).with_buffer(core::mem::take(&mut self.other));
        let mut dialogue = Dialogue::Upload(upload);
        let read = self
            .converse(&mut dialogue, Transfer::read(other), timeout)
            .await;
        self.other = dialogue.into_data();
        matches!(read, Ok(()) | Err(Failure::Fault(SdoFault::Aborted(_))))
    }
}

// A transfer as the client sees it: of either direction, with the reasons for which it fails.

/// A transfer of either direction, or a question.
#[derive(Debug)]
pub(super) enum Dialogue {
    Upload(Upload),
    Download(Download),
    Inquiry(Inquiry, Question),
}

impl Dialogue {
    /// What it asks for, for who does not have the mailbox.
    pub fn into_request(self) -> RemoteRequest {
        match self {
            Self::Upload(upload) => RemoteRequest::Read {
                object: upload.object(),
                complete_access: upload.is_complete_access(),
            },
            Self::Download(download) => RemoteRequest::Write {
                object: download.object(),
                complete_access: download.is_complete_access(),
                data: download.into_data(),
            },
            Self::Inquiry(_, question) => RemoteRequest::Ask(question),
        }
    }

    /// Makes of `message` the one that is due.
    fn compose(&self, message: &mut Vec<u8>, counter: Counter) {
        match self {
            Self::Upload(upload) => sdo_message(message, counter, |message| {
                message.extend_from_slice(&upload.request());
            }),
            Self::Download(download) => {
                sdo_message(message, counter, |message| download.append_request(message));
            }
            Self::Inquiry(inquiry, _) => {
                information_message(message, counter, |message| inquiry.append_request(message));
            }
        }
    }

    /// Takes a reply. `nothing_late` if no reply of an earlier request can come any more.
    fn feed(
        &mut self,
        reply: MailboxMessage<'_>,
        nothing_late: bool,
    ) -> Result<TransferStep, Failure> {
        let step = match (self, reply) {
            (Self::Upload(upload), MailboxMessage::SdoReply(reply)) => upload.feed(reply),
            (Self::Download(download), MailboxMessage::SdoReply(reply)) => download.feed(reply),
            (Self::Inquiry(inquiry, _), MailboxMessage::SdoInformation(reply)) => {
                inquiry.feed(reply)
            }
            // A device without the service may say so by an SDO abort.
            (Self::Inquiry(..), MailboxMessage::SdoReply(&[0x80, _, _, _, c0, c1, c2, c3, ..]))
                if nothing_late =>
            {
                let code = AbortCode(u32::from_le_bytes([c0, c1, c2, c3]));
                return Err(Failure::NoService(NoInformation::Service(code)));
            }
            _ => Ok(TransferStep::Foreign),
        };
        step.map_err(Failure::Fault)
    }

    /// Whether the device writes the object when it takes the message that is due. Not where segments follow: their toggle bit
    /// shows one that comes twice.
    fn writes_at_once(&self) -> bool {
        match self {
            Self::Download(download) => !download.is_segmented() && download.fits_one_message(),
            Self::Upload(_) | Self::Inquiry(..) => false,
        }
    }

    const fn is_question(&self) -> bool {
        matches!(self, Self::Inquiry(..))
    }

    const fn is_segmented(&self) -> bool {
        match self {
            Self::Upload(upload) => upload.is_segmented(),
            Self::Download(download) => download.is_segmented(),
            Self::Inquiry(..) => false,
        }
    }

    /// What a reply would be now.
    pub fn waits_for(&self) -> SdoStep {
        match self {
            Self::Inquiry(inquiry, _) if inquiry.is_under_way() => SdoStep::Fragment,
            _ if self.is_segmented() => SdoStep::Segment,
            _ => SdoStep::Reply,
        }
    }

    /// Bytes that the answer has had.
    pub const fn room_taken(&self) -> usize {
        match self {
            Self::Upload(upload) => upload.received(),
            Self::Download(_) => 0,
            Self::Inquiry(inquiry, _) => inquiry.received(),
        }
    }

    pub fn into_data(self) -> Vec<u8> {
        match self {
            Self::Upload(upload) => upload.into_data(),
            Self::Download(_) => Vec::new(),
            Self::Inquiry(inquiry, _) => inquiry.into_data(),
        }
    }

    /// Distinguishes the refusal of a question from a device without the service.
    pub fn judge(&self, error: SdoError) -> SdoError {
        let Self::Inquiry(_, question) = self else {
            return error;
        };
        let is_about_all = matches!(question, Question::Counts | Question::List(_));
        let reason = match &error {
            SdoError::Mailbox { error, .. } if error.is_about_the_service() => {
                NoInformation::MailboxMessage(*error)
            }
            SdoError::Aborted { code, .. }
                if is_about_all
                    && matches!(*code, AbortCode::COMMAND | AbortCode::UNSUPPORTED_ACCESS) =>
            {
                NoInformation::Service(*code)
            }
            _ => return error,
        };
        SdoError::NotSupported {
            transfer: error.transfer(),
            reason,
        }
    }
}

/// Why an exchange failed, before it is reported with its object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Failure {
    Fault(SdoFault),
    Refused(MailboxError),
    /// The device has no SDO information.
    NoService(NoInformation),
    NotTaken,
    NoReply,
    /// The late reply of an earlier transfer has not come, nor any other.
    EarlierReply,
    /// The frame with the message is lost, and the device must not get it twice.
    Doubtful,
    Link(LinkFault),
}

impl Failure {
    /// The error, where it may allocate: on the caller's thread.
    pub fn describe(self, transfer: Transfer, after: Duration, reply: SdoStep) -> SdoError {
        let timeout = |step| SdoError::Timeout {
            transfer,
            step,
            after,
        };
        match self {
            Self::Fault(fault) => SdoError::from_fault(transfer, fault),
            Self::Refused(error) => SdoError::Mailbox { transfer, error },
            Self::NoService(reason) => SdoError::NotSupported { transfer, reason },
            Self::EarlierReply => timeout(SdoStep::EarlierReply),
            Self::NotTaken => timeout(SdoStep::Sending),
            Self::NoReply | Self::Doubtful => timeout(reply),
            Self::Link(fault) => SdoError::Link {
                transfer,
                step: reply,
                reason: fault.to_string(),
            },
        }
    }

    /// The abort code for the device, if it has to get one.
    const fn abort_code(&self) -> Option<AbortCode> {
        match self {
            Self::Fault(fault) => fault.abort_code(),
            Self::NotTaken | Self::NoReply => Some(AbortCode::TIME_OUT),
            Self::Refused(_)
            | Self::NoService(_)
            | Self::EarlierReply
            | Self::Doubtful
            | Self::Link(_) => None,
        }
    }
}

// Which counter the next message gets. A device drops a message with the counter of the last one that it took, and there are only
// seven counters. After a message that it never took, the next one must not get the counter of the last one taken.

/// The counters of the messages to one device.
#[derive(Debug)]
struct Counters {
    /// Of the message that is due.
    current: Counter,
    /// The last message that the device took may have had one of these: bits by the counters.
    taken: u8,
}

impl Default for Counters {
    fn default() -> Self {
        // The next one is the first.
        let current = (1..7).fold(Counter::FIRST, |counter, _| counter.next());
        Self { current, taken: 0 }
    }
}

impl Counters {
    /// For the next message: none that the last message taken may have had, as long as there is another.
    fn next(&mut self) -> Counter {
        let mut next = self.current.next();
        while self.taken & bit(next) != 0 && next != self.current {
            next = next.next();
        }
        if self.taken & bit(next) != 0 {
            // All are in doubt. The one that was given last is the likeliest to be the last taken, the oldest the least likely.
            next = self.current.next();
        }
        self.current = next;
        next
    }

    /// The device took the message with the counter that was given last.
    fn taken(&mut self) {
        self.taken = bit(self.current);
    }

    /// Whether it took that, nobody knows.
    fn perhaps_taken(&mut self) {
        self.taken |= bit(self.current);
    }
}

const fn bit(counter: Counter) -> u8 {
    1 << counter.get()
}

#[cfg(test)]
mod counter_tests {
    use super::Counters;

    #[test]
    fn when_all_counters_are_in_doubt_no_two_messages_in_a_row_get_the_same_one() {
        let mut counters = Counters::default();
        let mut last = None;
        for number in 0..30 {
            let next = counters.next().get();
            assert!((1..=7).contains(&next));
            assert_ne!(Some(next), last, "message {number}");
            counters.perhaps_taken();
            last = Some(next);
        }
        counters.taken();
        assert_ne!(Some(counters.next().get()), last);
    }
}

// When a device's mailbox is looked at while its answer is due: by how long it took for the answer before.
//
// Each look costs the line a datagram, each reading of an empty mailbox one as long as the mailbox.

/// Pauses between two looks grow with the time waited, from this one on.
const SHORTEST_PAUSE: Duration = Duration::from_micros(50);
/// Who answers within this time is read at once.
const AT_ONCE: Duration = Duration::from_micros(100);
/// No first look is later: the answer before may have been an exception.
const LATEST_FIRST_LOOK: Duration = Duration::from_millis(4);

/// How long a device takes for its answers.
#[derive(Debug, Default)]
struct PollTiming {
    /// The answer before took so long.
    last: Duration,
}

impl PollTiming {
    /// Whether its answer is expected to be there as soon as the request is.
    fn is_quick(&self) -> bool {
        self.last <= AT_ONCE
    }

    fn answered_after(&mut self, time: Duration) {
        self.last = time;
    }

    /// How long after the request the first look is worth its frame. It is somewhat before the answer is expected, so that an
    /// estimate that was too long comes down.
    fn first_look(&self) -> Duration {
        (self.last * 3 / 4).min(LATEST_FIRST_LOOK)
    }

    /// The pause before the next look, after this time.
    fn pause(&self, waited: Duration, longest: Duration) -> Duration {
        (waited / 16).max(SHORTEST_PAUSE).min(longest)
    }
}

// What the bus loop sees of a device's mailbox within its cycles, for the client of that mailbox.

/// Nobody else looks at the mailbox: the client does.
const UNWATCHED: u8 = 0;
/// No message waited when the mailbox was looked at last.
const EMPTY: u8 = 1;
/// A message waits.
const FULL: u8 = 2;

/// Wakes a mailbox client when a message waits, so that it asks for nothing while there is none. Clones are the same signal.
///
/// It follows the level of the mailbox's state: a message that is not read away is seen again. Observing neither allocates
/// nor locks.
#[derive(Debug, Clone, Default)]
pub(crate) struct MailboxSignal(Arc<MailboxLevel>);

#[derive(Debug, Default)]
struct MailboxLevel {
    seen: AtomicU8,
    /// The device has been in INIT since the client was at its mailbox.
    begins_anew: AtomicBool,
    client: AtomicWaker,
}

impl MailboxSignal {
    /// The mailbox was looked at. Frames that were sent before a message was read must have been observed before the client
    /// is polled after that reading.
    pub fn observe(&self, message_waits: bool) {
        let seen = if message_waits { FULL } else { EMPTY };
        if self.0.seen.swap(seen, Ordering::AcqRel) != seen && message_waits {
            self.0.client.wake();
        }
    }

    /// The mailbox will not be looked at any more: the client does it from now on.
    pub fn end(&self) {
        self.0.seen.store(UNWATCHED, Ordering::Release);
        self.0.client.wake();
    }

    /// The device is in INIT: it has forgotten what it was to answer, and counts its messages from the beginning.
    pub fn begin_anew(&self) {
        self.0.begins_anew.store(true, Ordering::Release);
    }

    /// Whether it began anew since this was asked last.
    fn has_begun_anew(&self) -> bool {
        self.0.begins_anew.swap(false, Ordering::AcqRel)
    }

    fn is_watched(&self) -> bool {
        self.0.seen.load(Ordering::Acquire) != UNWATCHED
    }

    /// Forgets a message that was seen: the client has been at the mailbox since.
    fn forget(&self) {
        // Fails where none was seen.
        let _ = self
            .0
            .seen
            .compare_exchange(FULL, EMPTY, Ordering::AcqRel, Ordering::Acquire);
    }

    /// Resolves when a message waits (true), or nobody looks any more (false).
    async fn message_waits(&self) -> bool {
        poll_fn(|context| {
            self.0.client.register(context.waker());
            match self.0.seen.load(Ordering::Acquire) {
                FULL => Poll::Ready(true),
                UNWATCHED => Poll::Ready(false),
                _ => Poll::Pending,
            }
        })
        .await
    }
}
