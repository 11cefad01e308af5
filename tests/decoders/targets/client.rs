//! The mailbox client: any messages, and any fate of each access, while every kind of transfer is asked of it, in virtual time.

use std::cell::{Cell, RefCell};
use std::future::{Future, pending, poll_fn};
use std::pin::pin;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use servocrab::coe::information::ListKind;
use servocrab::coe::{
    Clock, DriveId, LinkFault, MailboxClient, MailboxSettings, MailboxStatus, MailboxTransport, obj,
};
use servocrab::sii::{Identity, Mailbox, Protocols};

use super::Script;
use super::memory::within;

/// Bytes of both mailboxes.
const MAILBOX: u16 = 64;
/// Every wait that the client can be in, with room.
const REPLY: Duration = Duration::from_millis(5);

/// The device and the link to it, out of a script: a byte for each access, and the messages.
struct Scripted<'a> {
    script: RefCell<Script<'a>>,
    counter: Cell<u8>,
    accesses: Cell<usize>,
}

impl Scripted<'_> {
    /// The fate of an access; 0 behind the script's end.
    async fn fate(&self) -> Result<u8, LinkFault> {
        self.accesses.set(self.accesses.get() + 1);
        let fate = self.script.borrow_mut().byte();
        match fate {
            0xF0 => Err(LinkFault::Lost),
            0xF1 => Err(LinkFault::NotAnswered),
            0xF2 => Err(LinkFault::Busy),
            0xF3 => pending().await,
            _ => Ok(fate),
        }
    }
}

impl MailboxTransport for Scripted<'_> {
    async fn write_message(&self, message: &[u8]) -> Result<bool, LinkFault> {
        assert!(message.len() <= usize::from(MAILBOX));
        Ok(self.fate().await? != 1)
    }

    async fn read_message(&self, message: &mut [u8]) -> Result<bool, LinkFault> {
        let fate = self.fate().await?;
        // A whole message, or the content of a CoE message of one of its services.
        let service = match fate {
            1 => None,
            2..=15 => Some(u16::from(fate)),
            _ => return Ok(false),
        };
        let part = self.script.borrow_mut().part();
        let mut bytes = part.to_vec();
        if let Some(service) = service {
            let counter = self.counter.get() % 7 + 1;
            self.counter.set(counter);
            let [l0, l1] = (2 + part.len() as u16).to_le_bytes();
            let [s0, s1] = (service << 12).to_le_bytes();
            bytes = [&[l0, l1, 0, 0, 0, 3 | counter << 4, s0, s1], part].concat();
        }
        for (to, from) in message.iter_mut().zip(bytes) {
            *to = from;
        }
        Ok(true)
    }

    async fn status(&self) -> Result<MailboxStatus, LinkFault> {
        let bits = self.fate().await?;
        Ok(MailboxStatus {
            request_pending: bits & 1 != 0,
            message_waiting: bits & 2 != 0,
            repeat_requested: bits & 4 != 0,
            repeat_done: bits & 8 != 0,
        })
    }

    async fn request_repeat(&self, _: bool) -> Result<(), LinkFault> {
        self.fate().await.map(drop)
    }
}

/// Time that moves to the next moment for which somebody waits.
#[derive(Default)]
struct Virtual {
    now: Cell<Duration>,
    next: Cell<Option<Duration>>,
}

impl Clock for &Virtual {
    fn now(&self) -> Duration {
        self.now.get()
    }

    async fn sleep_until(&self, time: Duration) {
        poll_fn(|_| {
            if self.now.get() >= time {
                return Poll::Ready(());
            }
            let next = self.next.get().map_or(time, |next| next.min(time));
            self.next.set(Some(next));
            Poll::Pending
        })
        .await;
    }
}

/// Asks everything once, the first byte says from where on. Every question ends, at the latest a bounded time after the
/// device has nothing more to say, and the client holds at most 64 KiB and 16 times what it was told.
pub fn run(data: &[u8]) {
    let mut script = Script(data);
    let first = script.byte() % 8;
    let device = Scripted {
        script: RefCell::new(script),
        counter: Cell::new(0),
        accesses: Cell::new(0),
    };
    let clock = Virtual::default();
    let mailbox = Mailbox {
        receive_offset: 0x1000,
        receive_length: MAILBOX,
        send_offset: 0x1100,
        send_length: MAILBOX,
        protocols: Protocols(4),
    };
    let settings = MailboxSettings {
        frame_timeout: Duration::from_millis(1),
        read_timeout: Duration::from_micros(500),
        reply_timeout: REPLY,
        poll_interval: Duration::from_millis(1),
        emergency_capacity: 4,
        ..MailboxSettings::new(&mailbox)
    };
    let drive = DriveId {
        position: 0,
        name: "scripted".to_owned(),
        identity: Identity::default(),
    };
    within(64 * 1024 + 16 * data.len(), || {
        let (client, handle, emergencies) =
            MailboxClient::new(Borrowed(&device), &clock, settings, drive);
        let questions = async {
            for question in (0..8).map(|question| (question + first) % 8) {
                match question {
                    0 => drop(handle.read(obj::STATUSWORD).await),
                    1 => drop(handle.read_bytes(0x1008, 0).await),
                    2 => drop(handle.write_bytes(0x1008, 0, vec![1; 100]).await),
                    3 => drop(handle.read_complete(0x1018, 0).await),
                    4 => drop(handle.write_complete(0x1018, 1, vec![2; 20]).await),
                    5 => drop(handle.object_list(ListKind::All).await),
                    6 => drop(handle.describe_object(0x1018).await),
                    _ => drop(handle.describe_entry(0x1018, 1).await),
                }
            }
        };
        let both = beside(client.run(), questions);
        until_over(both, &clock, REPLY * (100 + 2 * data.len() as u32));
        while emergencies.try_next().is_some() {}
    });
    // Each access has its deadline: a script of n bytes is over after n of them, and what follows are timeouts.
    assert!(device.accesses.get() <= 2000 + 20 * data.len());
}

/// The client owns its transport.
struct Borrowed<'a, 'b>(&'a Scripted<'b>);

impl MailboxTransport for Borrowed<'_, '_> {
    async fn write_message(&self, message: &[u8]) -> Result<bool, LinkFault> {
        self.0.write_message(message).await
    }

    async fn read_message(&self, message: &mut [u8]) -> Result<bool, LinkFault> {
        self.0.read_message(message).await
    }

    async fn status(&self) -> Result<MailboxStatus, LinkFault> {
        self.0.status().await
    }

    async fn request_repeat(&self, toggle: bool) -> Result<(), LinkFault> {
        self.0.request_repeat(toggle).await
    }
}

/// Ready when `second` is; `first` is polled beside it.
async fn beside(first: impl Future<Output = ()>, second: impl Future<Output = ()>) {
    let (mut first, mut second) = (pin!(first), pin!(second));
    poll_fn(|context| {
        if second.as_mut().poll(context).is_ready() || first.as_mut().poll(context).is_ready() {
            return Poll::Ready(());
        }
        // The answer to a question may have come just now.
        second.as_mut().poll(context)
    })
    .await;
}

fn until_over(future: impl Future<Output = ()>, clock: &Virtual, limit: Duration) {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    while future.as_mut().poll(&mut context).is_pending() {
        // Who is ready without waiting is polled again at the same moment.
        let next = clock.next.take().unwrap_or(clock.now.get());
        clock
            .now
            .set(next.max(clock.now.get()) + Duration::from_nanos(1));
        assert!(clock.now.get() < limit, "no end after {limit:?}");
    }
}
