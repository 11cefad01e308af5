//! The mailbox client: one actor per device, which alone touches its mailbox, on the thread that owns the bus.
//!
//! Transfers run one after another. A message whose reading is lost is asked for again by the repeat request. A request whose frame
//! is lost is sent again with the same mailbox counter, by which the device knows it. A request that writes an object is never sent
//! again, since a device that does not look at the counter would write twice: see `doubt`.
//!
//! Its messages have their memory from the beginning. All else that a transfer takes comes with its call (`calls`) and goes back
//! with the answer.

use alloc::sync::Arc;
use alloc::{vec, vec::Vec};
use core::future::Future;
use core::time::Duration;

use smol::future::or;

use super::calls::{Answer, Call, Request, Served, calls};
use super::emergencies::{Emergencies, EmergencyQueue};
use super::error::{DriveId, SdoStep, Transfer, Unsupported};
use super::error_texts::ErrorTexts;
use super::handle::SdoHandle;
use super::mail_signal::MailSignal;
use super::mailbox::{MailboxError, SHORTEST_MAILBOX, sdo_mail};
use super::sdo::{SdoFault, Step, abort_request};
use super::transport::{LinkFault, MailboxTransport};
use crate::wakes::Waiters;

#[cfg(test)]
mod tests;

mod access;
mod counters;
mod dialogue;
mod doubt;
mod late;
mod notes;
mod pace;
mod reading;
mod settings;

use counters::Counters;
pub(super) use dialogue::{Dialogue, Failure};
use doubt::{Doubt, LOOKED_FOR, Settled};
use late::MOST_OWED;
use notes::{Excerpt, MailEvent};
pub(crate) use notes::{MailNote, Notes};
use pace::Pace;
pub use settings::MailboxSettings;

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
    calls: Served,
    emergencies: EmergencyQueue,
    /// Where those of all drives of a network go.
    of_network: Option<EmergencyQueue>,
    texts: Arc<ErrorTexts>,
    /// Who takes what is to be logged; nobody: then it is written at once.
    notes: Option<Notes>,
    signal: MailSignal,
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
    doubt: Doubt,
    pace: Pace,
    /// Accesses that failed in a row.
    failures: u32,
}

/// What the client does next.
enum Next {
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
    Answer(Step),
}

impl<T: MailboxTransport, C: Clock> MailboxClient<T, C> {
    /// A client for the drive `drive`, with its handle and its emergencies.
    pub fn new(
        transport: T,
        clock: C,
        settings: MailboxSettings,
        drive: DriveId,
    ) -> (Self, SdoHandle, Emergencies) {
        let waiters = Waiters::direct;
        Self::with(transport, clock, settings, drive, waiters)
    }

    /// The same; the tasks that wait for it wait at these.
    pub(crate) fn with(
        transport: T,
        clock: C,
        settings: MailboxSettings,
        drive: DriveId,
        waiters: impl Fn() -> Arc<Waiters>,
    ) -> (Self, SdoHandle, Emergencies) {
        let (callers, calls) = calls(settings, waiters());
        let (queue, emergencies) = EmergencyQueue::new(settings.emergency_capacity, waiters());
        let drive = Arc::new(drive);
        let read_length = settings.read_length.max(SHORTEST_MAILBOX);
        let client = Self {
            drive: Arc::clone(&drive),
            transport,
            clock,
            settings,
            calls,
            emergencies: queue,
            of_network: None,
            texts: Arc::default(),
            notes: None,
            signal: MailSignal::default(),
            counters: Counters::default(),
            request: Vec::with_capacity(settings.write_length.max(SHORTEST_MAILBOX)),
            reply: vec![0; read_length],
            last: Vec::with_capacity(read_length),
            other: Vec::with_capacity(read_length),
            repeated: false,
            owed: Vec::with_capacity(MOST_OWED),
            sent_again: false,
            refusal: None,
            doubt: Doubt::default(),
            pace: Pace::default(),
            failures: 0,
        };
        let handle = SdoHandle {
            calls: Arc::new(callers),
            drive,
            timeout: None,
        };
        (client, handle, emergencies)
    }

    /// The same client for a drive whose error codes mean this.
    #[must_use]
    pub fn with_error_texts(mut self, texts: ErrorTexts) -> Self {
        self.texts = Arc::new(texts);
        self
    }

    /// The same client, whose emergencies go into this queue too.
    pub(crate) fn reporting_to(mut self, of_network: EmergencyQueue) -> Self {
        self.of_network = Some(of_network);
        self
    }

    /// The same client, whose notes for the log are taken by this.
    pub(crate) fn noting_to(mut self, notes: Notes) -> Self {
        self.notes = Some(notes);
        self
    }

    /// By which a bus loop reports what it sees of the mailbox: then the client does not look while nothing is due.
    pub(crate) fn signal(&self) -> MailSignal {
        self.signal.clone()
    }

    /// Serves the handles, and collects emergencies, until the last handle is dropped.
    pub async fn run(mut self) {
        loop {
            let next = or(async { Next::Call(self.calls.next().await) }, async {
                Next::Due(self.something_due().await)
            });
            match next.await {
                Next::Due(mail_waits) => self.collect(mail_waits).await,
                Next::Call(Some(call)) => {
                    self.serve(call).await;
                    self.signal.forget();
                }
                Next::Call(None) => return,
            }
        }
    }

    /// Waits until the mailbox is to be looked at though nothing was asked for. Whether a message is known to wait.
    async fn something_due(&self) -> bool {
        if self.signal.is_watched() {
            return self.signal.mail_waits().await;
        }
        let next = self.clock.now() + self.settings.idle_interval;
        self.clock.sleep_until(next).await;
        false
    }

    async fn serve(&mut self, call: Call) {
        let Call { mut request, place } = call;
        // Nobody waits any more and nothing was sent: withdrawn, and nobody looks at the result.
        let result = if place.is_left() {
            Ok(())
        } else {
            self.transfer(&mut request).await
        };
        let dialogue = request.dialogue;
        // A caller that went away meanwhile misses its result; the mailbox is in order.
        self.calls.answer(&place, Answer { dialogue, result });
    }

    async fn transfer(&mut self, request: &mut Request) -> Result<(), Failure> {
        let (transfer, timeout) = (request.transfer, request.timeout);
        let dialogue = &mut request.dialogue;
        if dialogue.is_question() && !self.settings.sdo_information {
            return Err(Failure::NoService(Unsupported::Sii));
        }
        if self.owes_like(transfer) {
            self.resynchronise(transfer, timeout).await?;
        }
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
                Ok(Step::Done) => {
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
                        sdo_mail(&mut self.request, counter, |mail| {
                            mail.extend_from_slice(&abort);
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
    ) -> Result<Step, Failure> {
        let mut asked_at = self.clock.now();
        let deadline = asked_at + timeout;
        self.failures = 0;
        self.refusal = None;
        let mut doubtful_from = None;
        // Further fragments of an answer come unasked.
        let mut sent = dialogue.waits_for() == SdoStep::Fragment;
        if !sent {
            let counter = self.counters.next();
            dialogue.compose(&mut self.request, counter);
            self.note(MailEvent::Request(transfer, Excerpt::of(&self.request)));
        }
        // The mailbox was empty when it was read without a look at its state: a frame that came twice may have read it.
        let mut perhaps_read = false;
        loop {
            if !sent && doubtful_from.is_none() {
                match self.send().await {
                    // A quick device has answered by now: its message is read without a look at the state before.
                    Ok(true) if self.pace.is_quick() => {
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
                        let first = asked_at + self.pace.first_look();
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
                        self.pace.answered_after(self.clock.now() - asked_at);
                        return Ok(step);
                    }
                    Found::Other => {}
                    Found::Nothing => break,
                }
            }
            let now = self.clock.now();
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
            let pause = self.pace.pause(now - asked_at, self.settings.poll_interval);
            self.clock.sleep_until((now + pause).min(deadline)).await;
        }
    }

    /// Puts the message that is due into the device's mailbox; `false` if that is full.
    async fn send(&mut self) -> Result<bool, LinkFault> {
        self.forget_the_session_before();
        let sent = self.access(self.transport.write_mail(&self.request)).await;
        match sent {
            Ok(true) => self.counters.taken(),
            Ok(false) => {}
            Err(_) => self.counters.perhaps_taken(),
        }
        sent
    }

    /// Whether the device has been in INIT: what it said before says nothing about what it says now.
    fn forget_the_session_before(&mut self) {
        if self.signal.has_begun_anew() {
            self.repeated = false;
            self.last.clear();
            self.owed.clear();
            self.sent_again = false;
        }
    }

    fn note(&self, event: MailEvent) {
        let drive = Arc::clone(&self.drive);
        let note = MailNote { drive, event };
        match &self.notes {
            Some(notes) => notes(self.clock.now(), note),
            None => note.write(self.clock.now()),
        }
    }
}
