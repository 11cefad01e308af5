//! What a program holds of a mailbox client: the handle for SDO transfers.

use alloc::sync::Arc;
use alloc::vec::Vec;
use core::future::poll_fn;
use core::sync::atomic::{AtomicBool, AtomicUsize, Ordering, fence};
use core::task::Poll;
use core::time::Duration;
use std::sync::OnceLock;

use atomic_waker::AtomicWaker;
use crossbeam_queue::ArrayQueue;
use smol::channel::{Receiver, Sender, bounded};

use super::client::{Dialogue, Failure, MailboxSettings};
use super::error::AbortCode;
use super::error::{DriveError, DriveId, SdoError, Transfer};
use super::information::{
    DictionaryObject, EntryDescription, Inquiry, ListKind, ObjectCounts, ObjectDescription,
    ObjectDictionary, Question, Undescribed, object_counts, object_list,
};
use super::object::{Object, ObjectAddress};
use super::sdo::{Download, SdoFault, Upload};
use super::value::{Number, ReadOnly, Readable, Value, Writable};
use crate::wakes::Waiters;

/// Reads and writes objects of one drive; clones share its mailbox, in which transfers run one after another.
///
/// A caller that drops its future leaves the mailbox in order. A transfer that has not begun is withdrawn; the client completes one
/// that has.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{DriveConfig, Network, drives, link::Wire};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// use servocrab::coe::{SdoError, obj};
/// let sdo = net.sdo(0).ok_or("no drive was declared there")?;
/// sdo.write(obj::QUICK_STOP_DECELERATION, 150_000).await?;
/// assert_eq!(sdo.read(obj::QUICK_STOP_DECELERATION).await?, 150_000); // typed
/// let bytes = sdo.read_bytes(0x6085, 0).await?; // an object without a name here
/// assert_eq!(bytes, 150_000_u32.to_le_bytes());
/// let refused = sdo.read_bytes(0x5FFF, 0).await.unwrap_err();
/// assert!(matches!(refused.error, SdoError::Aborted { .. }), "{refused}"); // no such object
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct SdoHandle {
    pub(super) server: Server,
    pub(super) drive: Arc<DriveId>,
    pub(super) timeout: Option<Duration>,
}

/// Who does the transfers.
#[derive(Debug, Clone)]
pub(super) enum Server {
    /// The client of the drive's mailbox.
    Mailbox(Arc<Callers>),
    /// Whoever passes them on to another program.
    Remote(Sender<RemoteTransfer>),
}

impl SdoHandle {
    /// The drive.
    #[must_use]
    pub fn drive(&self) -> &DriveId {
        &self.drive
    }

    /// The same handle with another time for each reply, for objects over which a device takes long (storing
    /// parameters). `Duration::MAX` waits until the device answers or is lost.
    #[must_use]
    pub const fn with_timeout(mut self, timeout: Duration) -> Self {
        self.timeout = Some(timeout);
        self
    }

    /// Reads an object.
    ///
    /// # Errors
    /// [`SdoError`] with the drive: it refused (`Aborted`, `Mailbox`), did not answer (`Timeout`, `Link`), broke
    /// the protocol (`UnexpectedReply`, `Toggle`, `Cut`), has the object with another width (`WrongSize`), or the
    /// bus is gone (`Closed`).
    pub async fn read<T: Value, A: Readable>(&self, object: Object<T, A>) -> Result<T, DriveError> {
        let transfer = Transfer::read(object.address());
        let width = match usize::from(T::DATA_TYPE.bits()) {
            0 => None,
            bits => Some(bits / 8),
        };
        let mut upload = Upload::new(transfer.object);
        if let Some(width) = width {
            upload = upload.width(width);
        }
        let data = self.upload(upload).await?;
        T::decode(&data).ok_or_else(|| {
            self.error(SdoError::WrongSize {
                transfer,
                expected: width.unwrap_or_default(),
                got: data.len(),
            })
        })
    }

    /// Writes an object; confirmed by the drive when the future resolves.
    ///
    /// A write is never made twice, whether the drive looks at the mailbox counter or not. One without a reply is not repeated. One
    /// whose frame is lost is sent again only when it is known never to have arrived: the drive has answered another request
    /// without answering this one. The toggle bit distinguishes segments.
    ///
    /// # Errors
    /// As [`SdoHandle::read`]. After `Timeout` and `Link` the write may have taken effect.
    pub async fn write<T: Value, A: Writable>(
        &self,
        object: Object<T, A>,
        value: T,
    ) -> Result<(), DriveError> {
        let download = self.new_download(object.address(), value.encode());
        self.download(download).await
    }

    /// Reads the bytes of `index:subindex`, as many as the drive sends.
    ///
    /// # Errors
    /// As [`SdoHandle::read`], but for `WrongSize` of a type.
    pub async fn read_bytes(&self, index: u16, subindex: u8) -> Result<Vec<u8>, DriveError> {
        let object = ObjectAddress::new(index, subindex);
        self.upload_bytes(Upload::new(object)).await
    }

    /// Writes `data` to `index:subindex`.
    ///
    /// # Errors
    /// As [`SdoHandle::write`].
    pub async fn write_bytes(
        &self,
        index: u16,
        subindex: u8,
        data: Vec<u8>,
    ) -> Result<(), DriveError> {
        let object = ObjectAddress::new(index, subindex);
        self.download(self.new_download(object, data)).await
    }

    /// Reads `index` from `subindex` on (0 or 1) with all subindices that follow, by complete access. From
    /// subindex 0 on the first two bytes are the count and a zero; elements lie one behind the other.
    ///
    /// # Errors
    /// As [`SdoHandle::read_bytes`]; many drives refuse with abort code 06010004h.
    pub async fn read_complete(&self, index: u16, subindex: u8) -> Result<Vec<u8>, DriveError> {
        let object = ObjectAddress::new(index, subindex);
        self.upload_bytes(Upload::new(object).complete_access())
            .await
    }

    /// The elements of an object whose subindex 0 is their number.
    pub(crate) async fn read_list<T: Number>(&self, index: u16) -> Result<Vec<T>, DriveError> {
        if let Some(list) = self.read_whole_list(index).await? {
            return Ok(list);
        }
        let count: Object<u8, ReadOnly> = Object::new(index, 0, "number of entries");
        let mut list = Vec::new();
        for subindex in 1..=self.read(count).await? {
            let element: Object<T, ReadOnly> = Object::new(index, subindex, "entry");
            list.push(self.read(element).await?);
        }
        Ok(list)
    }

    /// The same in one message. `None` of a drive whose SII says nothing of complete access, that refuses it here, or that answers with
    /// something else than such a list.
    pub(crate) async fn read_whole_list<T: Number>(
        &self,
        index: u16,
    ) -> Result<Option<Vec<T>>, DriveError> {
        let is_there = match &self.server {
            Server::Mailbox(calls) => calls
                .settings()
                .is_some_and(|settings| settings.complete_access),
            Server::Remote(_) => false,
        };
        if !is_there {
            return Ok(None);
        }
        let data = match self.read_complete(index, 0).await {
            Ok(data) => data,
            Err(DriveError {
                error: SdoError::Aborted { .. } | SdoError::Mailbox { .. },
                ..
            }) => return Ok(None),
            Err(error) => return Err(error),
        };
        let [count, 0, elements @ ..] = &data[..] else {
            return Ok(None);
        };
        let elements = elements.chunks(usize::from(T::BITS / 8));
        let list: Option<Vec<T>> = elements.map(T::decode).collect();
        Ok(list.filter(|list| list.len() == usize::from(*count)))
    }

    /// Writes `index` from `subindex` on (0 or 1) with all subindices that follow, by complete access. From
    /// subindex 0 on `data` begins with the count and a zero; elements lie one behind the other.
    ///
    /// # Errors
    /// As [`SdoHandle::write`]; many drives refuse with abort code 06010004h.
    pub async fn write_complete(
        &self,
        index: u16,
        subindex: u8,
        data: Vec<u8>,
    ) -> Result<(), DriveError> {
        let object = ObjectAddress::new(index, subindex);
        let download = self.new_download(object, data).complete_access();
        self.download(download).await
    }

    fn new_download(&self, object: ObjectAddress, data: Vec<u8>) -> Download {
        let mailbox = match &self.server {
            Server::Mailbox(calls) => calls.settings().map_or(0, |settings| settings.write_length),
            // The other program cuts it up for the drive's.
            Server::Remote(_) => 0,
        };
        Download::new(object, data, mailbox)
    }

    async fn download(&self, download: Download) -> Result<(), DriveError> {
        let transfer = Transfer::write(download.object());
        self.run(transfer, Dialogue::Download(download)).await?;
        Ok(())
    }

    async fn upload(&self, upload: Upload) -> Result<Vec<u8>, DriveError> {
        let transfer = Transfer::read(upload.object());
        let upload = upload.with_buffer(self.room());
        self.run(transfer, Dialogue::Upload(upload)).await
    }

    /// As [`SdoHandle::upload`], and no more room than the bytes take.
    async fn upload_bytes(&self, upload: Upload) -> Result<Vec<u8>, DriveError> {
        let mut data = self.upload(upload).await?;
        data.shrink_to_fit();
        Ok(data)
    }

    /// Room for any answer: the client finds none on its thread.
    pub(super) fn room(&self) -> Vec<u8> {
        match &self.server {
            Server::Mailbox(calls) => Vec::with_capacity(calls.room()),
            Server::Remote(_) => Vec::new(),
        }
    }

    async fn run(&self, transfer: Transfer, dialogue: Dialogue) -> Result<Vec<u8>, DriveError> {
        let calls = match &self.server {
            Server::Mailbox(calls) => calls,
            Server::Remote(calls) => {
                let request = dialogue.into_request();
                let answer = RemoteTransfer::call(calls, transfer, request, self.timeout).await;
                return answer.map_err(|error| self.error(error));
            }
        };
        let Some(settings) = calls.settings() else {
            return Err(self.error(SdoError::Absent { transfer }));
        };
        let timeout = self.timeout.unwrap_or(settings.reply_timeout);
        let request = Request {
            transfer,
            dialogue,
            timeout,
        };
        let answer = calls.call(request).await;
        let answer = answer.ok_or_else(|| self.error(SdoError::Closed { transfer }))?;
        match answer.result {
            Ok(()) => Ok(answer.dialogue.into_data()),
            Err(failure) => {
                let step = answer.dialogue.waits_for();
                let error = failure.describe(transfer, timeout, step);
                Err(self.error(answer.dialogue.judge(error)))
            }
        }
    }

    fn error(&self, error: SdoError) -> DriveError {
        DriveError {
            drive: DriveId::clone(&self.drive),
            error,
        }
    }
}

// Questions about a drive's object dictionary (SDO information).

/// Bytes that a dictionary may take. Drives have up to some thousands of entries, of some hundred bytes each.
const MOST_BYTES: usize = 16 << 20;

impl SdoHandle {
    /// Reads the drive's whole object dictionary: its list of objects, and what each object and each entry is.
    ///
    /// It takes one message and its answer for every object and every entry: seconds, on a drive with a thousand of them. What the
    /// drive lists but does not describe is listed apart ([`ObjectDictionary::undescribed`]).
    ///
    /// # Errors
    /// [`SdoError::NotSupported`] if the drive has no SDO information. Else as [`SdoHandle::read`], and `Fragments` where a part of
    /// an answer is missing. `WrongSize` if the descriptions take more than 16 MiB, as no drive's do.
    pub async fn dictionary(&self) -> Result<ObjectDictionary, DriveError> {
        self.dictionary_within(MOST_BYTES).await
    }

    pub(super) async fn dictionary_within(
        &self,
        most: usize,
    ) -> Result<ObjectDictionary, DriveError> {
        let mut dictionary = ObjectDictionary::default();
        let mut held = 0;
        let mut hold = |bytes: usize| {
            held += bytes;
            let transfer = Transfer::from(Question::List(ListKind::All));
            let fault = SdoFault::Size {
                expected: most,
                got: held,
            };
            (held <= most)
                .then_some(())
                .ok_or_else(|| self.error(SdoError::from_fault(transfer, fault)))
        };
        for index in self.object_list(ListKind::All).await? {
            let object = self.describe_object(index).await;
            let description = match refusal(object)? {
                Ok(description) => description,
                Err(code) => {
                    hold(size_of::<Undescribed>())?;
                    dictionary.undescribed.push(Undescribed {
                        index,
                        subindex: None,
                        code,
                    });
                    continue;
                }
            };
            hold(size_of::<DictionaryObject>() + description.name.len())?;
            let mut entries = Vec::new();
            for subindex in 0..=description.max_subindex {
                match refusal(self.describe_entry(index, subindex).await)? {
                    Ok(entry) => {
                        hold(entry.bytes())?;
                        entries.push(entry);
                    }
                    Err(AbortCode::NO_SUBINDEX) => {}
                    Err(code) => {
                        hold(size_of::<Undescribed>())?;
                        dictionary.undescribed.push(Undescribed {
                            index,
                            subindex: Some(subindex),
                            code,
                        });
                    }
                }
            }
            dictionary.objects.push(DictionaryObject {
                description,
                entries,
            });
        }
        Ok(dictionary)
    }

    /// How many objects the drive's lists have.
    ///
    /// # Errors
    /// As [`SdoHandle::dictionary`].
    pub async fn object_counts(&self) -> Result<ObjectCounts, DriveError> {
        self.ask(Question::Counts, object_counts).await
    }

    /// The indices of the objects of a list, in the drive's order.
    ///
    /// # Errors
    /// As [`SdoHandle::dictionary`].
    pub async fn object_list(&self, kind: ListKind) -> Result<Vec<u16>, DriveError> {
        self.ask(Question::List(kind), object_list).await
    }

    /// What an object is.
    ///
    /// # Errors
    /// As [`SdoHandle::dictionary`]; `Aborted` for an object that the drive does not have.
    pub async fn describe_object(&self, index: u16) -> Result<ObjectDescription, DriveError> {
        self.ask(Question::Object { index }, ObjectDescription::parse)
            .await
    }

    /// What an entry of an object is, with unit, default and limits as far as the drive reports them.
    ///
    /// # Errors
    /// As [`SdoHandle::dictionary`]; `Aborted` for an entry that the drive does not have.
    pub async fn describe_entry(
        &self,
        index: u16,
        subindex: u8,
    ) -> Result<EntryDescription, DriveError> {
        let question = |wanted| Question::Entry {
            index,
            subindex,
            wanted,
        };
        let parse = EntryDescription::parse;
        match self.ask(question(Question::EVERYTHING), parse).await {
            // A drive may refuse what it does not know of an entry, or say that it reports it and not do so.
            Err(DriveError {
                error: SdoError::Aborted { code, .. },
                ..
            }) if !code.is_no_object() => {}
            Err(DriveError {
                error: SdoError::Cut { .. },
                ..
            }) => {}
            other => return other,
        }
        self.ask(question(Question::BASICS), parse).await
    }

    async fn ask<T>(
        &self,
        question: Question,
        parse: impl Fn(&[u8]) -> Result<T, SdoFault>,
    ) -> Result<T, DriveError> {
        let answer = self.information(question).await?;
        let transfer = Transfer::from(question);
        parse(&answer).map_err(|fault| self.error(SdoError::from_fault(transfer, fault)))
    }

    /// The bytes of the drive's answer to a question of SDO information, as [`Inquiry`] gives them: for who passes questions on.
    ///
    /// # Errors
    /// As [`SdoHandle::dictionary`]; `Aborted` for what the drive does not have.
    pub async fn information(&self, question: Question) -> Result<Vec<u8>, DriveError> {
        let inquiry = Inquiry::new(question).with_buffer(self.room());
        let dialogue = Dialogue::Inquiry(inquiry, question);
        self.run(Transfer::from(question), dialogue).await
    }
}

/// A refusal of one description apart from what ends the reading.
fn refusal<T>(result: Result<T, DriveError>) -> Result<Result<T, AbortCode>, DriveError> {
    match result {
        Ok(value) => Ok(Ok(value)),
        Err(DriveError {
            error: SdoError::Aborted { code, .. },
            ..
        }) => Ok(Err(code)),
        Err(error) => Err(error),
    }
}

// How transfers get from any thread to the mailbox client, and their outcomes back. Each call has a cell, which its caller makes.
//
// On the client's thread nothing is allocated and nothing freed. A dialogue brings its buffers along and goes back with them. An
// answered cell stays in the place until the next caller takes the place and drops what is in it.
//
// An answer frees the place, whether the caller has read it or not. So a future that nobody polls holds up no other, be it one that
// waits for a place.

/// Bytes that are got ready for an answer of unknown length, as long as none was longer: more than most objects have.
const USUAL_ROOM: usize = 4096;

/// The channel of those who wait for a place.
const PLACE: u32 = 1;

/// A transfer on its way to the client.
#[derive(Debug)]
pub(super) struct Request {
    pub transfer: Transfer,
    /// With room for what it will hold.
    pub dialogue: Dialogue,
    /// The time for each reply.
    pub timeout: Duration,
}

/// A transfer that is over.
#[derive(Debug)]
pub(super) struct Answer {
    pub dialogue: Dialogue,
    pub result: Result<(), Failure>,
}

/// A request and where its answer goes.
#[derive(Debug)]
pub(super) struct Call {
    pub request: Request,
    pub place: Served,
}

/// The client's end of a cell. Its caller is woken with it, answered or not.
#[derive(Debug)]
pub(super) struct Served(Arc<CallSlot>);

impl Served {
    /// Whether the caller of a call that is not answered has gone away.
    pub fn is_left(&self) -> bool {
        self.0.left.load(Ordering::Acquire)
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.0.over.store(true, Ordering::Release);
        self.0.caller.wake();
    }
}

/// Room for one call: empty, or with the cell of the call before.
type Place = Option<Served>;

/// Where a caller waits for its answer.
#[derive(Debug)]
struct CallSlot {
    /// Room for one.
    answer: ArrayQueue<Answer>,
    caller: AtomicWaker,
    /// The caller has gone away.
    left: AtomicBool,
    /// The client is through with the call.
    over: AtomicBool,
}

#[derive(Debug)]
struct Calls {
    free: ArrayQueue<Place>,
    /// Room for a call from each place.
    waiting: ArrayQueue<Call>,
    client: AtomicWaker,
    /// The program's futures that wait for an answer, or for a place.
    waiters: Arc<Waiters>,
    callers_gone: AtomicBool,
    client_gone: AtomicBool,
    /// Of the device's mailbox, once it is served.
    settings: OnceLock<MailboxSettings>,
    /// Bytes of the longest answer, or the usual room.
    longest: AtomicUsize,
}

/// The callers' end and the client's.
pub(super) fn calls(capacity: usize, waiters: Arc<Waiters>) -> (Callers, RequestReceiver) {
    // One is served while the others wait.
    let count = capacity.max(1).saturating_add(1);
    let free = ArrayQueue::new(count);
    for _ in 0..count {
        // There is room for all.
        let _ = free.push(None);
    }
    let calls = Arc::new(Calls {
        free,
        waiting: ArrayQueue::new(count),
        client: AtomicWaker::new(),
        waiters,
        callers_gone: AtomicBool::new(false),
        client_gone: AtomicBool::new(false),
        settings: OnceLock::new(),
        longest: AtomicUsize::new(USUAL_ROOM),
    });
    (Callers(Arc::clone(&calls)), RequestReceiver(calls))
}

/// The end of the callers; without it the client ends.
#[derive(Debug)]
pub(super) struct Callers(Arc<Calls>);

impl Callers {
    fn settings(&self) -> Option<&MailboxSettings> {
        self.0.settings.get()
    }

    /// Bytes that an answer of unknown length is to be given: no answer before was longer.
    pub fn room(&self) -> usize {
        self.0.longest.load(Ordering::Relaxed)
    }

    /// Hands `request` to the client, once there is a place for it, and waits for its answer; `None` if the client is gone.
    async fn call(&self, request: Request) -> Option<Answer> {
        // With what the call before has left behind.
        drop(self.place().await?);
        self.0.waiters.relay(self.call_directly(request)).await
    }

    /// A place, once there is one. All who wait are told of it: one that is not polled keeps it from nobody.
    async fn place(&self) -> Option<Place> {
        let calls = &*self.0;
        let free = || match calls.free.pop() {
            None if calls.client_gone.load(Ordering::Acquire) => Some(None),
            None => None,
            place => Some(place),
        };
        calls.waiters.until(PLACE, free).await
    }

    async fn call_directly(&self, request: Request) -> Option<Answer> {
        let calls = &*self.0;
        let cell = CallGuard(Arc::new(CallSlot {
            answer: ArrayQueue::new(1),
            caller: AtomicWaker::new(),
            left: AtomicBool::new(false),
            over: AtomicBool::new(false),
        }));
        let cell = &cell.0;
        let place = Served(Arc::clone(cell));
        calls.waiting.push(Call { request, place }).ok()?;
        calls.client.wake();
        poll_fn(|context| {
            cell.caller.register(context.waker());
            // Either this sees that the client has gone, or the client sees this call.
            fence(Ordering::SeqCst);
            // Looked at first: what the client has answered before it went is an answer.
            let is_over = cell.over.load(Ordering::Acquire);
            let is_gone = calls.client_gone.load(Ordering::Acquire);
            match cell.answer.pop() {
                None if !is_over && !is_gone => Poll::Pending,
                answer => Poll::Ready(answer),
            }
        })
        .await
    }
}

impl Drop for Callers {
    fn drop(&mut self) {
        self.0.callers_gone.store(true, Ordering::Release);
        self.0.client.wake();
    }
}

/// A caller's end of its cell.
struct CallGuard(Arc<CallSlot>);

impl Drop for CallGuard {
    fn drop(&mut self) {
        self.0.caller.take();
        self.0.left.store(true, Ordering::Release);
    }
}

/// The end of the client; without it all calls end.
pub(super) struct RequestReceiver(Arc<Calls>);

impl RequestReceiver {
    /// From now on calls are served, with these settings.
    pub fn begin(&self, settings: MailboxSettings) {
        // A client serves its mailbox once.
        let _ = self.0.settings.set(settings);
    }

    /// The next call; `None` if nobody can call any more.
    pub async fn next(&self) -> Option<Call> {
        let calls = &*self.0;
        poll_fn(|context| {
            calls.client.register(context.waker());
            // Looked at first: what was asked before the last caller went is asked.
            let are_gone = calls.callers_gone.load(Ordering::Acquire);
            match calls.waiting.pop() {
                None if !are_gone => Poll::Pending,
                call => Poll::Ready(call),
            }
        })
        .await
    }

    /// Puts a call's answer into its cell, and gives the place back.
    pub fn answer(&self, place: Served, answer: Answer) {
        self.0
            .longest
            .fetch_max(answer.dialogue.room_taken(), Ordering::Relaxed);
        let cell = &place.0;
        // It is empty: a call is answered once.
        let _ = cell.answer.push(answer);
        cell.over.store(true, Ordering::Release);
        cell.caller.wake();
        // There is room for all.
        let _ = self.0.free.push(Some(place));
        self.0.waiters.announce(PLACE);
    }
}

impl Drop for RequestReceiver {
    fn drop(&mut self) {
        let calls = &*self.0;
        calls.client_gone.store(true, Ordering::Release);
        fence(Ordering::SeqCst);
        calls.waiters.announce(PLACE);
        while let Some(call) = calls.waiting.pop() {
            drop(call);
        }
    }
}

// Transfers of drives whose line another program has, for who passes them on to it.

/// Calls that may wait.
const WAITING: usize = 16;

/// What a transfer of an [`SdoHandle::remote`] asks for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RemoteRequest {
    /// The bytes of an object.
    Read {
        /// The object.
        object: ObjectAddress,
        /// All subindices from this one on at once.
        complete_access: bool,
    },
    /// To write an object.
    Write {
        /// The object.
        object: ObjectAddress,
        /// Its bytes.
        data: Vec<u8>,
        /// All subindices from this one on at once.
        complete_access: bool,
    },
    /// What the dictionary says: the bytes of the answer to this question, as [`Inquiry`](super::information::Inquiry) gives them.
    Ask(Question),
}

/// A transfer that somebody waits for.
#[derive(Debug)]
pub struct RemoteTransfer {
    transfer: Transfer,
    /// What is asked.
    pub request: RemoteRequest,
    /// The time for each reply, where the program has set one ([`SdoHandle::with_timeout`]).
    pub timeout: Option<Duration>,
    answer: Sender<Result<Vec<u8>, SdoError>>,
}

impl RemoteTransfer {
    pub(super) async fn call(
        calls: &Sender<Self>,
        transfer: Transfer,
        request: RemoteRequest,
        timeout: Option<Duration>,
    ) -> Result<Vec<u8>, SdoError> {
        let (answer, answered) = bounded(1);
        let call = Self {
            transfer,
            request,
            timeout,
            answer,
        };
        let closed = SdoError::Closed { transfer };
        if calls.send(call).await.is_err() {
            return Err(closed);
        }
        answered.recv().await.unwrap_or(Err(closed))
    }

    /// What its errors name.
    #[must_use]
    pub const fn transfer(&self) -> Transfer {
        self.transfer
    }

    /// Ends it. Where it is dropped instead, the transfer fails as [`SdoError::Closed`].
    pub fn answer(self, result: Result<Vec<u8>, SdoError>) {
        // Nobody waits for it any more.
        let _ = self.answer.try_send(result);
    }
}

/// The transfers of an [`SdoHandle::remote`] and its clones, in their order.
#[derive(Debug)]
pub struct RemoteTransfers(Receiver<RemoteTransfer>);

impl RemoteTransfers {
    /// The next one; `None` once the last handle is dropped.
    pub async fn next(&self) -> Option<RemoteTransfer> {
        self.0.recv().await.ok()
    }
}

impl SdoHandle {
    /// The objects of a drive whose line another program has, and the transfers that are to be passed on to it. Whoever passes them on
    /// decides what becomes of a transfer whose future is dropped.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// use servocrab::{coe::{DriveId, SdoHandle, obj}, sii::Identity};
    ///
    /// let drive = DriveId { position: 0, name: "lift".into(), identity: Identity::default() };
    /// let (sdo, transfers) = SdoHandle::remote(drive);
    /// let program = async {
    ///     while let Some(transfer) = transfers.next().await {
    ///         transfer.answer(Ok(vec![0x37, 0x16])); // as the other program has read it
    ///     }
    ///     unreachable!("the handle is not dropped")
    /// };
    /// let read = smol::block_on(smol::future::or(sdo.read(obj::STATUSWORD), program))?;
    /// assert_eq!(read, 0x1637);
    /// # Ok(())
    /// # }
    /// ```
    #[must_use]
    pub fn remote(drive: DriveId) -> (Self, RemoteTransfers) {
        let (calls, transfers) = bounded(WAITING);
        let handle = Self {
            server: Server::Remote(calls),
            drive: Arc::new(drive),
            timeout: None,
        };
        (handle, RemoteTransfers(transfers))
    }
}

#[cfg(test)]
mod tests {
    use std::pin::pin;
    use std::task::{Context, Waker};
    use std::thread;

    use super::*;
    use crate::coe::sdo::{TransferStep, Upload};
    use crate::coe::{AbortCode, obj, object::ObjectAddress};
    use crate::sii::{Identity, Mailbox, Protocols};

    /// Calls of which so many may wait, which are served.
    fn served_calls(capacity: usize) -> (Callers, RequestReceiver) {
        let (callers, served) = calls(capacity, Waiters::direct());
        served.begin(MailboxSettings::new(&Mailbox {
            receive_offset: 0,
            receive_length: 64,
            send_offset: 0,
            send_length: 64,
            protocols: Protocols(4),
        }));
        (callers, served)
    }

    fn request(index: u16) -> Request {
        let object = ObjectAddress::new(index, 0);
        Request {
            transfer: Transfer::read(object),
            dialogue: Dialogue::Upload(Upload::new(object)),
            timeout: Duration::ZERO,
        }
    }

    /// Answers each call by the index that it asks for.
    fn answer(served: &RequestReceiver, call: Call) {
        let Call { request, place } = call;
        let [i0, i1] = request.transfer.object.index.to_le_bytes();
        let Dialogue::Upload(mut upload) = request.dialogue else {
            panic!("no upload");
        };
        let fed = upload.feed(&[0x4B, i0, i1, 0, i0, i1, 0, 0]);
        assert_eq!(fed, Ok(TransferStep::Done));
        let dialogue = Dialogue::Upload(upload);
        let result = Ok(());
        served.answer(place, Answer { dialogue, result });
    }

    #[test]
    fn every_caller_gets_its_own_answer_and_every_place_is_given_back_though_callers_go_away() {
        const CALLS: u16 = 400;
        let (callers, served) = served_calls(2);
        let callers = Arc::new(callers);
        let asked: Vec<_> = (0..6u16)
            .map(|thread| {
                let callers = Arc::clone(&callers);
                thread::spawn(move || {
                    smol::block_on(async {
                        for number in 0..CALLS {
                            let index = thread << 12 | number;
                            let mut call = pin!(callers.call(request(index)));
                            if number % 3 == 1 {
                                // It goes away at some moment.
                                for _ in 0..number % 5 {
                                    if smol::future::poll_once(call.as_mut()).await.is_some() {
                                        break;
                                    }
                                    thread::yield_now();
                                }
                                continue;
                            }
                            let answer = call.await.unwrap();
                            assert_eq!(answer.result, Ok(()));
                            assert_eq!(answer.dialogue.into_data(), index.to_le_bytes());
                        }
                    });
                })
            })
            .collect();
        let client = thread::spawn(move || {
            smol::block_on(async {
                while let Some(call) = served.next().await {
                    answer(&served, call);
                }
            });
        });
        for thread in asked {
            thread.join().unwrap();
        }
        let shared = Arc::clone(&callers.0);
        drop(callers);
        client.join().unwrap();
        assert_eq!(shared.free.len(), 3);
    }

    #[test]
    fn what_a_caller_leaves_behind_is_no_answer_for_the_next() {
        let (callers, served) = served_calls(1);
        let mut context = Context::from_waker(Waker::noop());
        for left in [1, 2] {
            {
                let mut call = pin!(callers.call(request(0x1000 + left)));
                assert!(call.as_mut().poll(&mut context).is_pending());
            }
            let call = smol::block_on(served.next()).unwrap();
            assert!(call.place.is_left());
            answer(&served, call);
        }
        for index in 0x2000..0x2004 {
            let mut call = pin!(callers.call(request(index)));
            assert!(call.as_mut().poll(&mut context).is_pending());
            answer(&served, smol::block_on(served.next()).unwrap());
            let Poll::Ready(Some(answer)) = call.as_mut().poll(&mut context) else {
                panic!("no answer");
            };
            assert_eq!(answer.dialogue.into_data(), index.to_le_bytes());
        }
        assert_eq!(callers.0.free.len(), 2);
    }

    /// A program keeps a call that waits for a place, and does not poll it again.
    #[test]
    fn a_call_that_waits_for_a_place_and_is_not_polled_keeps_it_from_no_other() {
        struct Woken(AtomicBool);
        impl std::task::Wake for Woken {
            fn wake(self: Arc<Self>) {
                self.0.store(true, Ordering::Release);
            }
        }
        let (callers, served) = served_calls(1);
        let mut context = Context::from_waker(Waker::noop());
        let mut kept: Vec<_> = (0..3).map(|_| Box::pin(callers.call(request(1)))).collect();
        for call in &mut kept {
            assert!(call.as_mut().poll(&mut context).is_pending());
        }
        let woken = Arc::new(Woken(AtomicBool::new(false)));
        let waker = Waker::from(Arc::clone(&woken));
        let mut context = Context::from_waker(&waker);
        let mut call = pin!(callers.call(request(2)));
        assert!(call.as_mut().poll(&mut context).is_pending());
        answer(&served, smol::block_on(served.next()).unwrap());
        assert!(woken.0.load(Ordering::Acquire));
        assert!(call.as_mut().poll(&mut context).is_pending());
        for _ in 0..2 {
            answer(&served, smol::block_on(served.next()).unwrap());
        }
        assert!(call.as_mut().poll(&mut context).is_ready());
    }

    #[test]
    fn calls_that_wait_for_a_place_or_an_answer_end_with_the_client() {
        let (callers, served) = served_calls(1);
        let callers = Arc::new(callers);
        let waiting: Vec<_> = (0..4)
            .map(|index| {
                let callers = Arc::clone(&callers);
                thread::spawn(move || smol::block_on(callers.call(request(index))).is_none())
            })
            .collect();
        while callers.0.waiting.len() < 2 {
            thread::yield_now();
        }
        drop(served);
        for thread in waiting {
            assert!(thread.join().unwrap());
        }
    }

    #[test]
    fn the_client_serves_what_was_asked_and_ends_when_nobody_can_ask() {
        let (callers, served) = served_calls(1);
        let mut context = Context::from_waker(Waker::noop());
        {
            let mut call = pin!(callers.call(request(1)));
            assert!(call.as_mut().poll(&mut context).is_pending());
        }
        drop(callers);
        assert!(smol::block_on(served.next()).is_some());
        assert!(smol::block_on(served.next()).is_none());
    }

    #[test]
    fn what_is_asked_gets_to_the_other_program_and_what_it_answers_back() {
        let drive = DriveId {
            position: 2,
            name: "lift".into(),
            identity: Identity::default(),
        };
        let (sdo, transfers) = SdoHandle::remote(drive);
        let object = ObjectAddress::new(0x6081, 0);
        let patient = sdo.clone().with_timeout(Duration::from_secs(9));
        let program = async {
            let write = transfers.next().await.unwrap();
            let expected = RemoteRequest::Write {
                object,
                data: vec![1, 2, 0, 0],
                complete_access: false,
            };
            assert_eq!((&write.request, write.timeout), (&expected, None));
            write.answer(Ok(Vec::new()));
            let read = transfers.next().await.unwrap();
            let expected = RemoteRequest::Read {
                object: ObjectAddress::new(0x1600, 1),
                complete_access: true,
            };
            assert_eq!(read.request, expected);
            assert_eq!(read.timeout, Some(Duration::from_secs(9)));
            let (transfer, code) = (read.transfer(), AbortCode::NO_OBJECT);
            read.answer(Err(SdoError::Aborted { transfer, code }));
            let asked = transfers.next().await.unwrap();
            let question = Question::Object { index: 0x6081 };
            assert_eq!(asked.request, RemoteRequest::Ask(question));
            asked.answer(Ok(b"\x81\x60\x07\x00\x00\x07speed".into()));
            // Dropped: it will never be answered.
            drop(transfers.next().await);
        };
        let uses = async {
            sdo.write(obj::PROFILE_VELOCITY, 0x201).await.unwrap();
            let refused = patient.read_complete(0x1600, 1).await.unwrap_err();
            assert_eq!(refused.error.abort_code(), Some(AbortCode::NO_OBJECT));
            let described = sdo.describe_object(0x6081).await.unwrap();
            assert_eq!(described.name, "speed");
            let lost = sdo.read_bytes(0x6081, 0).await.unwrap_err();
            assert!(matches!(lost.error, SdoError::Closed { .. }), "{lost}");
        };
        smol::block_on(smol::future::zip(program, uses));
        drop((transfers, patient));
        let ended = smol::block_on(sdo.read(obj::PROFILE_VELOCITY)).unwrap_err();
        assert!(matches!(ended.error, SdoError::Closed { .. }), "{ended}");
    }
}
