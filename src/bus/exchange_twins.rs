//! Two exchanges that get the same answers: one looks only at what is other than before, the other judges every cycle as a
//! whole. Whatever they make of it must be the same.

use proptest::{collection::vec, prelude::*};

use super::{Exchange, tests::Sent};
use crate::bus::{
    frame::Tag,
    packing::{Member, Sign, logical_addresses},
    statistics::Counters,
};

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
enum Line {
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
    lines: Vec<Line>,
    seen: Option<(usize, Seen)>,
}

/// What is known of a device beside its answers.
#[derive(Debug, Clone, Copy)]
enum Seen {
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
            sign: if any_bits {
                Sign::AnyBits
            } else {
                Sign::Statusword
            },
            patience,
        };
        let placed = members.into_iter().zip(logical_addresses(&sizes));
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
        30 => Just(Line::Good),
        1 => Just(Line::Lost),
        1 => any::<(u16, u8)>().prop_map(|(at, bits)| Line::Damaged(at, bits)),
        1 => (-3..4i16).prop_map(Line::Miscounted),
    ];
    let seen = prop_oneof![
        Just(Seen::InOp),
        Just(Seen::Fallen),
        Just(Seen::Away),
        Just(Seen::PutBack),
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
        if let Line::Miscounted(by) = line {
            counter = counter.wrapping_add_signed(by);
        }
        frame[part.data.end..part.data.end + 2].copy_from_slice(&counter.to_le_bytes());
    }
    frame[6] |= 2;
    match line {
        Line::Lost => return None,
        Line::Damaged(at, bits) => {
            let at = usize::from(at) % frame.len();
            frame[at] ^= bits;
        }
        Line::Good | Line::Miscounted(_) => {}
    }
    Some(frame)
}

proptest! {
    #[test]
    fn what_is_judged_calmly_is_judged_as_a_whole(
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
                        Seen::InOp => (drive.operational, drive.fallen) = (true, false),
                        Seen::Fallen => (drive.operational, drive.fallen) = (false, true),
                        Seen::PutBack => drive.put_back(),
                        Seen::Away => exchange.drives.take_away(place),
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
fn where_all_is_right_it_is_judged_calmly() {
    let member = |logical, sign| Member {
        logical,
        outputs: 2,
        inputs: 11,
        lrw: true,
        sign,
        patience: 3,
    };
    let members = [member(0, Sign::Statusword), member(13, Sign::AnyBits)];
    let (mut exchange, counters) = (
        Exchange::new(&members, Vec::new(), None),
        Counters::default(),
    );
    let lived = Lived {
        does: vec![Does::Stays; 2],
        lines: vec![Line::Good],
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
    assert!(exchange.all_fresh && exchange.packed.parts.iter().all(|part| part.calm));
}
