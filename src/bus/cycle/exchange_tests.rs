//! The rule of who answered, on frames that a test answers by hand.

use std::{io, task::Waker, time::Duration};

use proptest::{collection::vec, prelude::*};

use crate::{
    bus::cycle::{
        Answer, Exchange, PATTERN, PATTERNS, SeenState,
        frame::{BEHIND_TAG, InputMarker, Member, Tag, logical_addresses},
        statistics::Counters,
    },
    link::Link,
};

/// Keeps what was sent.
#[derive(Default)]
struct Sent(Vec<Vec<u8>>);

impl Link for Sent {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        self.0.push(frame.to_vec());
        Ok(())
    }

    fn receive(&mut self, _: &mut [u8]) -> io::Result<Option<usize>> {
        Ok(None)
    }

    fn wait(&mut self, _: Duration) {}

    fn now(&self) -> Duration {
        Duration::ZERO
    }

    fn waker(&self) -> Waker {
        Waker::noop().clone()
    }
}

/// Two drives with one byte of outputs and two of inputs each; a drive is lost after three silent cycles.
fn two_drives() -> Exchange {
    let member = |logical| Member {
        logical,
        outputs: 1,
        inputs: 2,
        lrw: true,
        marker: InputMarker::Statusword,
        patience: 3,
        leaves: false,
    };
    Exchange::new(&[member(0), member(3)], Vec::new(), None)
}

/// First data byte of the first datagram behind the tag.
const DATA: usize = BEHIND_TAG + 10;
const COUNTER: usize = DATA + 6;

/// One cycle, of which `answer` makes the reply.
fn cycle(exchange: &mut Exchange, counters: &Counters, answer: impl Fn(&mut [u8])) -> [Answer; 2] {
    let mut link = Sent::default();
    exchange.send(&mut link, counters);
    for mut frame in link.0 {
        answer(&mut frame);
        frame[6] |= 2;
        if let Some(tag) = Tag::of_answer(&frame) {
            exchange.accept(tag, &frame, counters);
        }
    }
    exchange.judge(counters);
    [exchange.drives[0].answer, exchange.drives[1].answer]
}

fn worth(exchange: &Exchange, place: usize) -> Answer {
    exchange.drives[place].worth()
}

fn both(frame: &mut [u8]) {
    frame[DATA + 1..DATA + 3].copy_from_slice(&[0x31, 0x02]);
    frame[DATA + 4..DATA + 6].copy_from_slice(&[0x37, 0x06]);
    frame[COUNTER] = 6;
}

fn first_alone(frame: &mut [u8]) {
    frame[DATA + 1..DATA + 3].copy_from_slice(&[0x31, 0x02]);
    frame[COUNTER] = 3;
}

#[test]
fn input_areas_are_sent_as_a_pattern_that_is_no_ds402_state() {
    use crate::ds402::{State, Statusword};
    let pattern = Statusword::from_bits_retain(u16::from_le_bytes([PATTERN; 2]));
    assert_eq!(pattern.state(), State::Unknown);
    let mut exchange = two_drives();
    exchange.drives.outputs_mut(0).unwrap()[0] = 0x0F;
    let mut link = Sent::default();
    exchange.send(&mut link, &Counters::default());
    assert_eq!(
        link.0[0][DATA..COUNTER],
        [0x0F, PATTERN, PATTERN, 0, PATTERN, PATTERN]
    );
}

#[test]
fn all_is_fresh_when_the_working_counter_is_right() {
    let (mut exchange, counters) = (two_drives(), Counters::default());
    assert_eq!(cycle(&mut exchange, &counters, both), [Answer::Fresh; 2]);
    assert_eq!(*exchange.drives[1].inputs, [0x37, 0x06]);
    assert_eq!(counters.read().wrong_working_counters, 0);
}

#[test]
fn a_silent_drive_leaves_the_others_answered_and_its_own_inputs_stale() {
    let (mut exchange, counters) = (two_drives(), Counters::default());
    cycle(&mut exchange, &counters, both);
    for _ in 0..2 {
        assert_eq!(
            cycle(&mut exchange, &counters, first_alone),
            [Answer::Answered, Answer::Stale]
        );
    }
    assert_eq!(
        *exchange.drives[1].inputs,
        [0x37, 0x06],
        "the pattern is never passed on as inputs"
    );
    // Lost: from now on nothing is expected of it.
    cycle(&mut exchange, &counters, first_alone);
    assert!(exchange.drives[1].lost);
    assert_eq!(
        cycle(&mut exchange, &counters, first_alone),
        [Answer::Fresh, Answer::Stale]
    );
    assert_eq!(counters.read().wrong_working_counters, 3);
    // And expected again in the cycle in which it answers.
    assert_eq!(cycle(&mut exchange, &counters, both), [Answer::Fresh; 2]);
    assert!(!exchange.drives[1].lost);
}

#[test]
fn outputs_that_were_not_taken_make_no_cycle_fresh() {
    let (mut exchange, counters) = (two_drives(), Counters::default());
    let answers = cycle(&mut exchange, &counters, |frame| {
        both(frame);
        frame[COUNTER] = 4;
    });
    assert_eq!(answers, [Answer::Answered; 2]);
}

#[test]
fn a_frame_of_an_earlier_cycle_is_counted_as_late_and_its_data_are_not_used() {
    let (mut exchange, counters) = (two_drives(), Counters::default());
    let mut first = Sent::default();
    exchange.send(&mut first, &counters);
    exchange.judge(&counters);
    let mut second = Sent::default();
    exchange.send(&mut second, &counters);
    let mut late = first.0.remove(0);
    both(&mut late);
    late[6] |= 2;
    let tag = Tag::of_answer(&late).unwrap();
    assert!(!exchange.accept(tag, &late, &counters));
    exchange.judge(&counters);
    assert_eq!(exchange.drives[0].answer, Answer::Stale);
    assert_eq!((counters.read().late, counters.read().lost), (1, 2));
}

/// What becomes of a frame that comes back so many cycles after its own.
fn late_by(cycles: u64) -> ([Answer; 2], u64, Option<u32>) {
    let (mut exchange, counters) = (two_drives(), Counters::default());
    let mut first = Sent::default();
    exchange.send(&mut first, &counters);
    exchange.judge(&counters);
    // Nothing of the cycles between is kept but their number.
    exchange.cycle += cycles - 1;
    exchange.send(&mut Sent::default(), &counters);
    let mut late = first.0.remove(0);
    both(&mut late);
    late[6] |= 2;
    let tag = Tag::of_answer(&late).unwrap();
    assert!(!exchange.accept(tag, &late, &counters));
    exchange.judge(&counters);
    let answers = [exchange.drives[0].answer, exchange.drives[1].answer];
    (answers, counters.read().late, exchange.take_late())
}

#[test]
fn a_reply_that_comes_256_cycles_late_is_refused() {
    assert_eq!(late_by(256), ([Answer::Stale; 2], 1, Some(256)));
}

#[test]
fn a_reply_that_comes_65536_cycles_late_is_refused() {
    assert_eq!(late_by(65_536), ([Answer::Stale; 2], 1, Some(65_536)));
    let hours = 1 << 24;
    assert_eq!(late_by(hours), ([Answer::Stale; 2], 1, Some(1 << 24)));
}

/// Sends a cycle, gives its answer as `both` makes it to `change`, and says what was made of it.
fn changed(change: impl Fn(&mut Vec<u8>)) -> ([Answer; 2], Counters) {
    let (mut exchange, counters) = (two_drives(), Counters::default());
    cycle(&mut exchange, &counters, both);
    let mut link = Sent::default();
    exchange.send(&mut link, &counters);
    let mut frame = link.0.remove(0);
    both(&mut frame);
    frame[6] |= 2;
    change(&mut frame);
    if let Some(tag) = Tag::of_answer(&frame) {
        exchange.accept(tag, &frame, &counters);
    }
    exchange.judge(&counters);
    let answers = [exchange.drives[0].answer, exchange.drives[1].answer];
    (answers, counters)
}

#[test]
fn a_frame_that_was_changed_anywhere_but_in_its_data_is_used_for_nothing() {
    assert_eq!(changed(|_| {}).0, [Answer::Fresh; 2]);
    // Source address, EtherType, EtherCAT length; of the tag and of the datagram behind it command, index, address, length.
    let headers = (6..15).chain(16..24).chain(BEHIND_TAG..BEHIND_TAG + 8);
    for at in headers {
        // Bit 6 of a length is the mark of a frame that circulates, which is no change of ours.
        let is_length = [23, BEHIND_TAG + 7].contains(&at);
        let bit = if is_length { 0x04 } else { 0x40 };
        let (answers, counters) = changed(|frame| frame[at] ^= bit);
        assert_eq!(answers, [Answer::Stale; 2], "byte {at}");
        assert_eq!(counters.read().lost, 1, "byte {at}");
    }
    for length in 0..76 {
        let (answers, _) = changed(|frame| frame.truncate(length.min(frame.len() - 1)));
        assert_eq!(answers, [Answer::Stale; 2], "cut to {length}");
    }
}

#[test]
fn a_doubled_frame_is_taken_once_and_counted_as_late() {
    let (mut exchange, counters) = (two_drives(), Counters::default());
    let mut link = Sent::default();
    exchange.send(&mut link, &counters);
    let mut first = link.0.remove(0);
    both(&mut first);
    first[6] |= 2;
    let tag = Tag::of_answer(&first).unwrap();
    assert!(exchange.accept(tag, &first, &counters));
    let mut second = first.clone();
    second[DATA + 1] = 0x40;
    exchange.accept(tag, &second, &counters);
    exchange.judge(&counters);
    assert_eq!(*exchange.drives[0].inputs, [0x31, 0x02]);
    assert_eq!(counters.read().late, 1);
    exchange.accept(tag, &second, &counters);
    assert_eq!(counters.read().late, 2, "after the cycle as well");
}

#[test]
fn inputs_of_which_one_bit_differs_from_the_pattern_are_an_answer() {
    let (mut exchange, counters) = (two_drives(), Counters::default());
    let answers = cycle(&mut exchange, &counters, |frame| {
        both(frame);
        frame[DATA + 4..DATA + 6].copy_from_slice(&[PATTERN, PATTERN & 0x7F]);
    });
    assert_eq!(answers, [Answer::Fresh; 2]);
    let answers = cycle(&mut exchange, &counters, |frame| {
        both(frame);
        frame[DATA + 4..DATA + 6].copy_from_slice(&[PATTERN; 2]);
    });
    assert_eq!(
        answers,
        [Answer::Fresh, Answer::Stale],
        "a right working counter does not make the pattern an answer"
    );
}

#[test]
fn a_drive_that_comes_back_is_not_taken_to_be_in_op_before_its_state_was_read() {
    let (mut exchange, counters) = (two_drives(), Counters::default());
    for drive in exchange.drives.iter_mut() {
        drive.seen = SeenState::Op;
    }
    cycle(&mut exchange, &counters, both);
    assert_eq!(worth(&exchange, 1), Answer::Fresh);
    for _ in 0..3 {
        cycle(&mut exchange, &counters, first_alone);
    }
    cycle(&mut exchange, &counters, both);
    assert_eq!(worth(&exchange, 0), Answer::Fresh);
    assert_eq!(worth(&exchange, 1), Answer::Answered);
}

#[test]
fn a_drive_that_has_left_op_and_closes_its_outputs_does_not_hold_up_the_others() {
    let (mut exchange, counters) = (two_drives(), Counters::default());
    for drive in exchange.drives.iter_mut() {
        drive.seen = SeenState::Op;
    }
    let closed = |frame: &mut [u8]| {
        both(frame);
        frame[COUNTER] = 4;
    };
    assert_eq!(
        cycle(&mut exchange, &counters, closed),
        [Answer::Answered; 2]
    );
    exchange.drives[1].seen = SeenState::LeftOp;
    assert_eq!(cycle(&mut exchange, &counters, closed)[0], Answer::Fresh);
    assert_eq!(worth(&exchange, 1), Answer::Answered);
    assert_eq!(cycle(&mut exchange, &counters, both)[0], Answer::Fresh);
    let less = |frame: &mut [u8]| {
        both(frame);
        frame[COUNTER] = 3;
    };
    assert_eq!(cycle(&mut exchange, &counters, less)[0], Answer::Answered);
}

/// A drive, and a device whose inputs can be anything: no outputs, two bytes of inputs.
fn drive_and_inputs() -> Exchange {
    let member = |logical, outputs, marker| Member {
        logical,
        outputs,
        inputs: 2,
        lrw: true,
        marker,
        patience: 3,
        leaves: false,
    };
    Exchange::new(
        &[
            member(0, 1, InputMarker::Statusword),
            member(3, 0, InputMarker::AnyBits),
        ],
        Vec::new(),
        None,
    )
}

#[test]
fn any_inputs_are_taken_where_the_working_counter_is_right() {
    let (mut exchange, counters) = (drive_and_inputs(), Counters::default());
    for value in [PATTERNS[0], PATTERNS[1], 0x00, 0xFF].repeat(2) {
        let answers = cycle(&mut exchange, &counters, |frame| {
            frame[DATA + 1..DATA + 3].copy_from_slice(&[0x31, 0x02]);
            frame[DATA + 3..DATA + 5].fill(value);
            frame[DATA + 5] = 4;
        });
        assert_eq!(answers, [Answer::Fresh; 2], "{value:02X}h");
        assert_eq!(*exchange.drives[1].inputs, [value; 2]);
    }
}

#[test]
fn where_it_is_wrong_inputs_that_are_equal_to_the_pattern_are_known_in_the_next_cycle() {
    let (mut exchange, counters) = (drive_and_inputs(), Counters::default());
    // The drive is silent; the inputs stand still.
    let mut answers = Vec::new();
    for _ in 0..2 {
        answers.push(cycle(&mut exchange, &counters, |frame| {
            frame[DATA + 3..DATA + 5].fill(PATTERNS[0]);
            frame[DATA + 5] = 1;
        }));
    }
    answers.sort_by_key(|[_, inputs]| *inputs == Answer::Stale);
    assert_eq!(
        answers,
        [
            [Answer::Stale, Answer::Answered],
            [Answer::Stale, Answer::Stale]
        ]
    );
}

#[test]
fn inputs_that_did_not_come_are_stale_in_every_cycle_and_the_pattern_is_never_passed_on() {
    let (mut exchange, counters) = (drive_and_inputs(), Counters::default());
    for cycles in 1..=4 {
        let answers = cycle(&mut exchange, &counters, |frame| {
            frame[DATA + 1..DATA + 3].copy_from_slice(&[0x31, 0x02]);
            frame[DATA + 5] = 3;
        });
        let drive = if cycles < 3 {
            Answer::Answered
        } else {
            Answer::Fresh
        };
        if cycles != 3 {
            assert_eq!(answers, [drive, Answer::Stale], "{cycles}");
        }
        assert_eq!(*exchange.drives[1].inputs, [0, 0]);
    }
    assert!(exchange.drives[1].lost);
}

#[test]
fn a_device_without_inputs_has_a_datagram_of_its_own_whose_counter_tells_whether_it_is_there() {
    let member = |logical, inputs, marker| Member {
        logical,
        outputs: 1,
        inputs,
        lrw: true,
        marker,
        patience: 3,
        leaves: false,
    };
    let mut exchange = Exchange::new(
        &[
            member(0, 0, InputMarker::AnyBits),
            member(1, 2, InputMarker::Statusword),
        ],
        Vec::new(),
        None,
    );
    let counters = Counters::default();
    // One byte and its working counter, then the header of the drive's datagram.
    let drive = DATA + 1 + 2 + 10;
    let answer = |outputs_there: bool| {
        move |frame: &mut [u8]| {
            frame[DATA + 1] = if outputs_there { 2 } else { 0 };
            frame[drive + 1..drive + 3].copy_from_slice(&[0x31, 0x02]);
            frame[drive + 3] = 3;
        }
    };
    assert_eq!(
        cycle(&mut exchange, &counters, answer(true)),
        [Answer::Fresh; 2]
    );
    for _ in 0..4 {
        assert_eq!(
            cycle(&mut exchange, &counters, answer(false)),
            [Answer::Stale, Answer::Fresh],
            "the drive's outputs count as delivered"
        );
    }
    assert!(exchange.drives[0].lost);
    assert_eq!(
        cycle(&mut exchange, &counters, answer(true)),
        [Answer::Fresh; 2]
    );
    assert!(!exchange.drives[0].lost);
}

#[test]
fn each_frame_of_a_cycle_has_a_place_of_its_own_and_more_than_have_one_are_refused() {
    // Each has a frame to itself.
    let long = |logical| Member {
        logical,
        outputs: 694,
        inputs: 694,
        lrw: true,
        marker: InputMarker::Statusword,
        patience: 3,
        leaves: false,
    };
    let exchange = |frames: u32| {
        let members: Vec<_> = (0..frames).map(|place| long(1388 * place)).collect();
        Exchange::new(&members, Vec::new(), None).checked()
    };
    let mut most = exchange(255).unwrap();
    let mut link = Sent::default();
    most.send(&mut link, &Counters::default());
    for frame in &mut link.0 {
        frame[6] |= 2;
    }
    let tags = link.0.iter().filter_map(|frame| Tag::of_answer(frame));
    assert!(tags.eq((0..255).map(|place| Tag::cyclic(1, place))));
    let error = exchange(256).err().map(|error| error.to_string());
    assert_eq!(
        error.as_deref(),
        Some(
            "the process data need 256 frames, and a cycle has at most 255: map less, or divide the line into several networks"
        )
    );
}

// Two exchanges that get the same answers: one looks only at what is other than before, the other judges every cycle as a
// whole. Whatever they make of it must be the same.

/// What one device does in a cycle.
#[derive(Debug, Clone, Copy)]
enum Does {
    /// It shows what it showed before.
    Stays,
    /// All of its inputs are these.
    Shows(u8),
    /// The first byte alone is.
    Dithers(u8),
    Silent,
    /// It does not take its outputs.
    Closed,
}

/// What the line does to a frame of a cycle.
#[derive(Debug, Clone, Copy)]
enum FrameFate {
    Good,
    Lost,
    /// One byte is another, at this share of its length.
    Damaged(u16, u8),
    /// The working counters are others.
    Miscounted(i16),
}

#[derive(Debug, Clone)]
struct Lived {
    does: Vec<Does>,
    lines: Vec<FrameFate>,
    seen: Option<(usize, ShownByDrive)>,
}

/// What is known of a device beside its answers.
#[derive(Debug, Clone, Copy)]
enum ShownByDrive {
    InOp,
    /// It has left OP.
    Fallen,
    /// It is set up anew from now on, or no longer.
    Away,
    PutBack,
}

fn members() -> impl Strategy<Value = Vec<Member>> {
    let sizes = (
        prop_oneof![Just(0usize), 1..20usize],
        prop_oneof![Just(0usize), 1..20usize, 8..17usize, Just(400usize)],
    );
    let member = (sizes, any::<bool>(), any::<bool>(), 1..4u32);
    vec(member, 1..8).prop_map(|members| {
        let sizes: Vec<_> = members.iter().map(|(sizes, ..)| *sizes).collect();
        let of = |(((outputs, inputs), lrw, any_bits, patience), logical)| Member {
            logical,
            outputs,
            inputs,
            lrw,
            marker: if any_bits {
                InputMarker::AnyBits
            } else {
                InputMarker::Statusword
            },
            patience,
            leaves: false,
        };
        let placed = members.into_iter().zip(logical_addresses(0, &sizes));
        placed.map(of).collect()
    })
}

fn lived() -> impl Strategy<Value = Lived> {
    let byte = prop_oneof![Just(0x55u8), Just(0xAAu8), Just(0xFFu8), any::<u8>()];
    let does = prop_oneof![
        30 => Just(Does::Stays),
        4 => byte.clone().prop_map(Does::Shows),
        4 => byte.prop_map(Does::Dithers),
        1 => Just(Does::Silent),
        1 => Just(Does::Closed),
    ];
    let line = prop_oneof![
        30 => Just(FrameFate::Good),
        1 => Just(FrameFate::Lost),
        1 => any::<(u16, u8)>().prop_map(|(at, bits)| FrameFate::Damaged(at, bits)),
        1 => (-3..4i16).prop_map(FrameFate::Miscounted),
    ];
    let seen = prop_oneof![
        Just(ShownByDrive::InOp),
        Just(ShownByDrive::Fallen),
        Just(ShownByDrive::Away),
        Just(ShownByDrive::PutBack),
    ];
    let seen = prop_oneof![
        10 => Just(None),
        1 => (0..8usize, seen).prop_map(Some),
    ];
    (vec(does, 8), vec(line, 4), seen).prop_map(|(does, lines, seen)| Lived { does, lines, seen })
}

/// What came back of a frame that was sent: none if it was lost.
fn answered(
    exchange: &Exchange,
    place: usize,
    sent: &[u8],
    shows: &[Vec<u8>],
    lived: &Lived,
) -> Option<Vec<u8>> {
    let mut frame = sent.to_vec();
    let line = lived.lines[place % lived.lines.len()];
    for part in exchange.packed.parts.iter().filter(|p| p.frame == place) {
        let mut counter = 0;
        for share in &part.shares {
            let does = lived.does[share.drive];
            if matches!(does, Does::Silent) {
                continue;
            }
            if let Some(inputs) = &share.inputs {
                frame[inputs.clone()].copy_from_slice(&shows[share.drive]);
            }
            counter += match does {
                Does::Closed => u16::from(share.inputs.is_some()),
                _ => share.counts,
            };
        }
        if let FrameFate::Miscounted(by) = line {
            counter = counter.wrapping_add_signed(by);
        }
        frame[part.data.end..part.data.end + 2].copy_from_slice(&counter.to_le_bytes());
    }
    frame[6] |= 2;
    match line {
        FrameFate::Lost => return None,
        FrameFate::Damaged(at, bits) => {
            let at = usize::from(at) % frame.len();
            frame[at] ^= bits;
        }
        FrameFate::Good | FrameFate::Miscounted(_) => {}
    }
    Some(frame)
}

proptest! {
    #[test]
    fn the_short_check_judges_as_the_whole_one(
        members in members(),
        cycles in vec(lived(), 1..40),
    ) {
        let exchange = || Exchange::new(&members, Vec::new(), None);
        let (mut calm, mut whole) = (exchange(), exchange());
        let counters = [Counters::default(), Counters::default()];
        for counters in &counters {
            counters.count_drives(members.len());
        }
        let mut shows: Vec<_> = members.iter().map(|member| vec![0x31; member.inputs]).collect();
        for lived in cycles {
            for (shows, does) in shows.iter_mut().zip(&lived.does) {
                match does {
                    Does::Shows(byte) => shows.fill(*byte),
                    Does::Dithers(byte) => shows.iter_mut().take(1).for_each(|first| *first = *byte),
                    Does::Stays | Does::Silent | Does::Closed => {}
                }
            }
            // As if something had been amiss in the cycle before.
            whole.all_fresh = false;
            let mut judged = Vec::new();
            for (exchange, counters) in [&mut calm, &mut whole].into_iter().zip(&counters) {
                if let Some((place, seen)) = lived.seen
                    && let Some(drive) = exchange.drives.get_mut(place)
                {
                    match seen {
                        ShownByDrive::InOp => drive.seen = SeenState::Op,
                        ShownByDrive::Fallen => drive.seen = SeenState::LeftOp,
                        ShownByDrive::PutBack => {
                            exchange.drives.put_back(place);
                        }
                        ShownByDrive::Away => exchange.drives.take_away(place),
                    }
                }
                let mut link = Sent::default();
                exchange.send(&mut link, counters);
                for (place, sent) in link.0.iter().enumerate() {
                    if let Some(frame) = answered(exchange, place, sent, &shows, &lived)
                        && let Some(tag) = Tag::of_answer(&frame)
                    {
                        exchange.accept(tag, &frame, counters);
                    }
                }
                let events = exchange.judge(counters);
                judged.push((events, format!("{:?}", &exchange.drives)));
            }
            prop_assert_eq!(&judged[0], &judged[1]);
            let [calm, whole] = counters.each_ref().map(|counters| {
                let drives = (0..members.len()).filter_map(|place| counters.drive(place));
                let drives: Vec<_> = drives.map(|d| (d.stale.get(), d.undelivered.get())).collect();
                (counters.read(), drives)
            });
            prop_assert_eq!(calm, whole);
        }
    }
}

#[test]
fn where_all_is_right_the_short_check_judges() {
    let member = |logical, marker| Member {
        logical,
        outputs: 2,
        inputs: 11,
        lrw: true,
        marker,
        patience: 3,
        leaves: false,
    };
    let members = [
        member(0, InputMarker::Statusword),
        member(13, InputMarker::AnyBits),
    ];
    let (mut exchange, counters) = (
        Exchange::new(&members, Vec::new(), None),
        Counters::default(),
    );
    let lived = Lived {
        does: vec![Does::Stays; 2],
        lines: vec![FrameFate::Good],
        seen: None,
    };
    for byte in 1..5 {
        let mut link = Sent::default();
        exchange.send(&mut link, &counters);
        let shows = [vec![byte; 11], vec![0x55; 11]];
        let frame = answered(&exchange, 0, &link.0[0], &shows, &lived).unwrap();
        let tag = Tag::of_answer(&frame).unwrap();
        exchange.accept(tag, &frame, &counters);
        exchange.judge(&counters);
    }
    assert!(exchange.all_fresh && exchange.packed.parts.iter().all(|part| part.steady));
}
