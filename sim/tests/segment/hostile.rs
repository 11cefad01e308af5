//! Frames and messages that are cut, that lie about their length or that are plain noise: never a panic, never a wrong effect.

use core::time::Duration;

use proptest::collection::vec;
use proptest::prelude::*;
use servocrab_sim::personality::Servo;
use servocrab_sim::{Segment, personality};

use crate::master::{BRD, BWR, FPRD, FPWR, LRW, Master, frame};

fn preop() -> Master {
    let segment = Segment::new()
        .with(personality::akd2g())
        .with(personality::io_terminal())
        .with(personality::coupler());
    let mut master = Master::new(segment);
    master.bring_to_preop();
    master
}

/// A generator of noise (xorshift64), so that a failure can be repeated.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }
}

#[test]
fn every_truncation_of_a_frame_executes_only_its_whole_datagrams() {
    let mut master = preop();
    let whole = frame(&[
        (BRD, 0, 0x0130, &[0; 2]),
        (FPRD, 0x1001, 0x0000, &[0; 16]),
        (LRW, 0, 0, &[0; 8]),
        (FPWR, 0x1001, 0x0120, &[2, 0]),
    ]);
    for length in 0..=whole.len() {
        let mut cut = whole[..length].to_vec();
        let processed = master.segment.process(&mut cut, Duration::ZERO);
        assert_eq!(processed, length >= 16, "length {length}");
        // The first datagram ends at byte 30; three devices answer it.
        if length >= 16 {
            assert_eq!(
                cut.get(28).copied().unwrap_or(0),
                if length >= 30 { 3 } else { 0 },
                "length {length}"
            );
        }
    }
}

#[test]
fn a_frame_of_another_ethertype_is_left_alone() {
    let mut master = preop();
    let mut bytes = frame(&[(BRD, 0, 0x0130, &[0; 2])]);
    bytes[12] = 0x08;
    let before = bytes.clone();
    assert!(!master.segment.process(&mut bytes, Duration::ZERO));
    assert_eq!(bytes, before);
}

#[test]
fn a_datagram_that_claims_more_than_the_frame_holds_is_not_executed() {
    let mut master = preop();
    let mut bytes = frame(&[(BWR, 0, 0x0120, &[1, 0])]);
    bytes[22] = 0xFF;
    assert!(master.segment.process(&mut bytes, Duration::ZERO));
    assert_eq!(master.al(0x1001), (2, 0));
}

#[test]
fn every_truncation_and_every_false_length_of_a_message_is_survived() {
    let messages: [&[u8]; 5] = [
        &[0x00, 0x20, 0x40, 0x18, 0x10, 0x01, 0, 0, 0, 0],
        &[0x00, 0x20, 0x2F, 0x60, 0x60, 0x00, 1, 0, 0, 0],
        &[0x00, 0x20, 0x21, 0x00, 0x5F, 0x00, 20, 0, 0, 0, 1, 2, 3],
        &[0x00, 0x20, 0x00, 1, 2, 3, 4, 5, 6, 7],
        &[0x00, 0x20, 0x60, 0, 0, 0, 0, 0, 0, 0],
    ];
    let mut master = preop();
    for mail in messages {
        for length in 0..=mail.len() {
            master.post(3, &mail[..length]);
            let (_, reply) = master.fetch().expect("every mail is answered");
            let expected_error: &[u8] = &[1, 0, 6, 0];
            if length < 10 {
                assert_eq!(reply, expected_error, "length {length}");
            } else {
                assert!(reply.len() >= 10, "length {length}");
            }
        }
    }
    for claimed in [0u16, 1, 1018, 1019, 0xFFFF] {
        let mut mail = vec![0; 1024];
        mail[..2].copy_from_slice(&claimed.to_le_bytes());
        mail[5] = 0x03;
        master.write(0x1001, 0x1800, &mail);
        assert!(master.fetch().is_some(), "length field {claimed}");
    }
}

#[test]
fn noise_in_the_place_of_datagrams_is_survived() {
    let mut noise = Noise(0x1234_5678_9ABC_DEF1);
    for round in 0..300 {
        let mut master = preop();
        for _ in 0..40 {
            let mut bytes = frame(&[(BRD, 0, 0, &[0; 200])]);
            // Any command, address and length, with data behind it.
            for byte in bytes.iter_mut().skip(16) {
                *byte = noise.next() as u8;
            }
            bytes[16] %= 16;
            bytes[23] = 0;
            // It may have opened a port without a link (0101h): then it does not come back.
            let now = Duration::from_millis(round);
            let _ = master.segment.process(&mut bytes, now);
        }
    }
}

#[test]
fn noise_in_the_registers_of_sync_managers_fmmus_and_clocks_is_survived() {
    let mut noise = Noise(0xFEED_0001);
    for _ in 0..200 {
        let mut master = preop();
        for area in [0x0600u16, 0x0800, 0x0900, 0x0980] {
            let bytes: Vec<u8> = (0..128).map(|_| noise.next() as u8).collect();
            master.exchange(BWR, 0, area, &bytes);
        }
        for address in [0x0FF0u16, 0x1000, 0x1800, 0x1C00, 0x2FF0, 0xFFF0] {
            master.exchange(BRD, 0, address, &[0; 64]);
            master.exchange(BWR, 0, address, &[0xA5; 64]);
        }
        let logical = noise.next();
        master.exchange(LRW, logical as u16, (logical >> 16) as u16, &[0; 64]);
        master.now += Duration::from_millis(3);
        master.exchange(BRD, 0, 0x0900, &[0; 256]);
        assert_eq!(master.exchange(BRD, 0, 0x0130, &[0; 2]).1, 3);
    }
}

/// CoE payloads: any bytes, or bytes that get past the first checks of a service.
fn payload() -> impl Strategy<Value = Vec<u8>> {
    let index = prop_oneof![
        prop::sample::select(vec![
            0x1003, 0x1008, 0x1018, 0x1600, 0x1A10, 0x1C12, 0x1C32, 0x5000, 0x5F00, 0x5F01, 0x607D,
            0x6840,
        ]),
        any::<u16>(),
    ];
    let initiate = (any::<u8>(), index, any::<u8>(), vec(any::<u8>(), 4..40)).prop_map(
        |(command, index, subindex, data)| {
            let mut payload = vec![0x00, 0x20, command];
            payload.extend(index.to_le_bytes());
            payload.push(subindex % 4);
            payload.extend(data);
            payload
        },
    );
    let information = (0..8u8, vec(any::<u8>(), 0..12)).prop_map(|(operation, data)| {
        let mut payload = vec![0x00, 0x80, operation, 0, 0, 0];
        payload.extend(data);
        payload
    });
    prop_oneof![
        3 => initiate,
        2 => information,
        1 => vec(any::<u8>(), 0..48),
    ]
}

/// Values at the edges of what objects take, and any others.
fn value() -> impl Strategy<Value = u32> {
    prop_oneof![
        prop::sample::select(vec![
            0,
            1,
            2,
            0x7F,
            0x80,
            0xFF,
            0x7FFF,
            0x8000,
            0xFFFF,
            0x7FFF_FFFF,
            0x8000_0000,
            0x8000_0001,
            u32::MAX,
        ]),
        any::<u32>(),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn no_value_of_any_object_upsets_a_drive_in_op(
        drive in prop::sample::select(vec![
            Servo::akd2g(), Servo::pp2010(), Servo::ax2000(), Servo::sigma7(), Servo::generic(),
        ]),
        steps in vec((any::<prop::sample::Index>(), value(), value(), 0..5u8), 1..60),
    ) {
        let mut master = Master::of(drive.build());
        master.bring_to_preop();
        master.bring_to_op(0x24);
        let objects: Vec<(u16, u8, usize)> = master
            .segment
            .axis(0, 0)
            .unwrap()
            .entries()
            .iter()
            .map(|entry| (entry.index, entry.subindex, entry.kind.size()))
            .collect();
        let mut outputs = vec![0; usize::from(master.lengths.0)];
        for (object, written, sent, cycles) in steps {
            let (index, subindex, size) = objects[object.index(objects.len())];
            // Refused or not: it is the drive's decision.
            let _answer = master.download(index, subindex, &written.to_le_bytes()[..size]);
            for (at, byte) in outputs.iter_mut().enumerate() {
                *byte = sent.to_le_bytes()[at % 4];
            }
            // The controlword comes first on all but one of these drives: mostly one that enables and starts.
            for controlword in [0x06, 0x07, 0x0F, 0x1F].into_iter().take(cycles.into()) {
                outputs[..2].copy_from_slice(&[controlword, sent as u8 & 0x03]);
                master.cycle(&outputs);
            }
        }
        prop_assert!(master.upload(0x1000, 0).is_ok());
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn no_message_upsets_the_drive(
        mailbox in prop_oneof![Just(1024u16), Just(64), Just(24), Just(16)],
        messages in vec((any::<u8>(), payload(), proptest::option::weighted(0.1, any::<u16>())), 1..40),
    ) {
        let drive = Servo::akd2g()
            .with_complete_access()
            .with_sdo_information()
            .mailbox_bytes(mailbox)
            .build();
        let mut master = Master::new(Segment::new().with(drive));
        master.mailbox = usize::from(mailbox);
        master.bring_to_preop();
        for (kind, payload, false_length) in messages {
            // Mostly CoE.
            let kind = if kind & 0x0F < 12 { kind & 0xF0 | 3 } else { kind };
            let length = false_length.unwrap_or(payload.len() as u16);
            let mut mail = length.to_le_bytes().to_vec();
            mail.extend([0, 0, 0, kind]);
            mail.extend(payload);
            mail.resize(usize::from(mailbox), 0);
            master.write(0x1001, 0x1800, &mail);
            for _ in 0..400 {
                let (mail, counter) = master.exchange(FPRD, 0x1001, 0x1C00, &vec![0; master.mailbox]);
                if counter == 0 {
                    break;
                }
                let length = usize::from(u16::from_le_bytes([mail[0], mail[1]]));
                prop_assert!(length >= 4 && length + 6 <= usize::from(mailbox), "{mail:02X?}");
                prop_assert_ne!(mail[5] >> 4, 0, "the drive's counter");
            }
        }
        // It still serves, with a counter that differs from the last one.
        master.post(0, &[]);
        prop_assert!(master.upload(0x1000, 0).is_ok());
    }
}
