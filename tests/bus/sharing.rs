//! Requests that share frames: each gets its own answer, what reaches a mailbox is sent once, and cycles stay on time.

use std::{
    collections::{BTreeSet, HashMap},
    future::Future,
    sync::{Arc, Mutex},
    time::Duration,
};

use servocrab::{
    DriveConfig, Network,
    bus::NetworkBuilder,
    coe::{DriveError, SdoError, obj},
    drives,
    link::{Fate, Wire},
};
use servocrab_sim::{Segment, personality::Servo};

use crate::{
    rig::{Line, Rig, TAG, TAG_BYTES, datagrams, is_cyclic, is_message},
    sdo::all,
};

const DRIVES: u16 = 8;

/// Drives whose messages are short enough to share a frame.
fn line() -> Line {
    Line::new((0..DRIVES).fold(Segment::new(), |segment, _| {
        segment.with(Servo::akd2g().mailbox_bytes(128).build())
    }))
}

fn network(wire: Wire) -> NetworkBuilder {
    (0..DRIVES).fold(Network::builder().link(wire), |builder, position| {
        let drive = DriveConfig::new(drives::akd2g());
        builder.drive(position, drive.axis(format!("{position}")))
    })
}

/// Writes a number of its own into every drive, all at once, and reads it back.
fn own_numbers(rig: &Rig) -> impl Future<Output = Vec<Result<u32, DriveError>>> + use<> {
    let tasks = (0..DRIVES)
        .map(|position| {
            let sdo = rig.net().sdo(position).unwrap();
            async move {
                let window = obj::POSITION_WINDOW;
                sdo.write(window, 1_000 + u32::from(position)).await?;
                sdo.read(window).await
            }
        })
        .collect();
    all(tasks)
}

/// What is said of every frame that is no cycle's.
#[derive(Default)]
struct Seen {
    frames: usize,
    datagrams: usize,
    most: usize,
    /// How often the frame with a number was sent, of those that reach a mailbox.
    messages: HashMap<u32, usize>,
    sent_again: usize,
    mixed: usize,
}

impl Seen {
    fn look(&mut self, frame: &[u8]) {
        let mut copy = frame.to_vec();
        let mut all = datagrams(&mut copy);
        let tag = all.remove(0);
        let number = u32::from_le_bytes([tag[2], tag[3], tag[4], tag[5]]);
        let messages = all.iter().filter(|datagram| is_message(datagram)).count();
        self.frames += 1;
        self.datagrams += all.len();
        self.most = self.most.max(all.len());
        if messages != 0 {
            self.mixed += usize::from(messages != all.len());
            let sent = self.messages.entry(number).or_default();
            *sent += 1;
            self.sent_again += usize::from(*sent > 1);
        }
    }
}

/// `fate` gets how many of these frames there were before: cycles come between them.
fn watched(
    line: &Line,
    fate: impl Fn(u64) -> Fate + Send + 'static,
) -> (Arc<Mutex<Seen>>, NetworkBuilder) {
    let seen = Arc::new(Mutex::new(Seen::default()));
    let looks = Arc::clone(&seen);
    let mut number = 0;
    let wire = line.wire_with(move |_, frame| {
        if is_cyclic(frame) {
            return Fate::Deliver;
        }
        looks.lock().unwrap().look(frame);
        number += 1;
        fate(number)
    });
    (seen, network(wire))
}

#[test]
fn all_frames_of_a_network_come_from_one_address_and_acyclic_ones_are_tagged_as_well() {
    let line = line();
    // The source addresses, and the numbers of frames of process data and others.
    type Set<T> = Arc<Mutex<BTreeSet<T>>>;
    let (addresses, numbers) = (Set::<Vec<u8>>::default(), Set::<(bool, Vec<u8>)>::default());
    let (seen, tags) = (Arc::clone(&addresses), Arc::clone(&numbers));
    let wire = line.wire_with(move |_, frame| {
        seen.lock().unwrap().insert(frame[6..12].to_vec());
        let tag = &frame[TAG..TAG + TAG_BYTES];
        assert_eq!(
            (tag[0], &tag[6..]),
            (0, &[4, 0x80, 0, 0, 0, 0, 0, 0, 0, 0][..])
        );
        tags.lock()
            .unwrap()
            .insert((is_cyclic(frame), tag[2..6].to_vec()));
        Fate::Deliver
    });
    let mut rig = Rig::start(network(wire)).unwrap();
    rig.run_for(Duration::from_millis(700));
    let axis = rig.net().axis("0").unwrap();
    assert!(rig.until(axis.enable()).is_ok());
    assert_eq!(
        *addresses.lock().unwrap(),
        BTreeSet::from([vec![0x10, 0xA5, 0, 0, 0, 1]])
    );
    let numbers = std::mem::take(&mut *numbers.lock().unwrap());
    let of = |cyclic| numbers.iter().filter(|(is, _)| *is == cyclic).count();
    assert!(
        of(true) > 600 && of(false) > 100,
        "{} {}",
        of(true),
        of(false)
    );
    rig.shutdown();
}

#[test]
fn requests_to_several_drives_share_frames_and_each_gets_its_own_answer() {
    let line = line();
    let (seen, builder) = watched(&line, |_| Fate::Deliver);
    let mut rig = Rig::start(builder).unwrap();
    {
        let seen = seen.lock().unwrap();
        assert!(seen.most >= usize::from(DRIVES), "{}", seen.most);
        assert!(
            seen.datagrams > 4 * seen.frames,
            "{} datagrams in {} frames",
            seen.datagrams,
            seen.frames
        );
    }
    let numbers = own_numbers(&rig);
    let numbers: Vec<_> = rig.until(numbers).into_iter().map(Result::unwrap).collect();
    let expected: Vec<_> = (1_000..1_000 + u32::from(DRIVES)).collect();
    assert_eq!(numbers, expected);
    rig.shutdown();
}

#[test]
fn a_drive_that_does_not_answer_fails_alone_of_those_in_its_frame() {
    let line = line();
    let mut rig = Rig::start(network(line.wire())).unwrap();
    // The last of the line: the others still hear.
    let last = usize::from(DRIVES) - 1;
    line.segment().device_mut(last).unwrap().power_off();
    let numbers = own_numbers(&rig);
    let numbers = rig.until(numbers);
    for (position, number) in numbers.iter().enumerate() {
        if position == last {
            let error = &number.as_ref().unwrap_err().error;
            assert!(matches!(error, SdoError::Link { .. }), "{error}");
        } else {
            assert!(number.is_ok(), "{position}: {number:?}");
        }
    }
}

/// Numbers without a period, which a dialogue that repeats itself would fall in step with.
fn scattered(number: u64) -> u64 {
    number.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40
}

#[test]
fn what_reaches_a_mailbox_is_sent_once_and_apart_from_what_is_sent_again() {
    // Five losses in a row end a transfer.
    for nth in [17, 23, 29] {
        let line = line();
        let (seen, builder) = watched(&line, move |number| match scattered(number) % nth {
            3 => Fate::LoseAnswer,
            5 => Fate::LoseRequest,
            _ => Fate::Deliver,
        });
        let mut rig = Rig::start(builder).unwrap();
        let numbers = own_numbers(&rig);
        let numbers = rig.until(numbers);
        for (position, number) in (1_000..).zip(numbers) {
            assert_eq!(number, Ok(position), "one of {nth} frames lost");
        }
        let seen = seen.lock().unwrap();
        assert!(seen.messages.len() > 100, "{}", seen.messages.len());
        assert_eq!((seen.sent_again, seen.mixed), (0, 0));
    }
}

#[test]
fn acyclic_frames_leave_the_cable_to_the_cycle() {
    // 80 ns a byte at 100 Mbit/s, and 24 bytes around each frame.
    let takes = |frame: &[u8]| Duration::from_nanos(80) * (frame.len().max(60) as u32 + 24);
    let mut segment = Segment::new();
    for _ in 0..DRIVES {
        segment.push(Servo::akd2g().build());
    }
    // Until when the cable is busy with acyclic frames, how late a cycle's frame came to it at most, and the longest frame.
    let watched = Arc::new(Mutex::new((Duration::ZERO, Duration::ZERO, Duration::ZERO)));
    let looks = Arc::clone(&watched);
    let wire = Wire::in_virtual_time(Duration::from_micros(10), move |frame: &mut [u8], now| {
        let (busy, late, longest) = &mut *looks.lock().unwrap();
        if is_cyclic(frame) {
            *late = (*late).max(busy.saturating_sub(now));
        } else {
            *busy = (*busy).max(now) + takes(frame);
            *longest = (*longest).max(takes(frame));
        }
        segment.process(frame, now)
    });
    let mut rig = Rig::start(network(wire)).unwrap();
    rig.run_for(Duration::from_millis(20));
    *watched.lock().unwrap() = Default::default();
    let texts = (0..DRIVES)
        .map(|position| {
            let sdo = rig.net().sdo(position).unwrap();
            async move {
                let text = vec![b'a' + position as u8; 3_000];
                sdo.write_bytes(0x5F00, 0, text.clone()).await.unwrap();
                sdo.read_bytes(0x5F00, 0).await.unwrap() == text
            }
        })
        .collect();
    assert!(rig.until(all(texts)).into_iter().all(|same| same));
    let (_, late, longest) = *watched.lock().unwrap();
    assert!(longest > Duration::from_micros(80), "{longest:?}");
    // One request goes in every gap, though the gap may be shorter.
    assert!(late <= longest, "{late:?} late, longest {longest:?}");
    rig.shutdown();
}
