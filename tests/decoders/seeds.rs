//! Inputs to begin with, made of bytes whose origin is known: `tests/vectors` (recorded from a real Kollmorgen AKD, and
//! between SOEM and other people's simulated drive; each file names its source) and the sample files in `sim/esi`.

use super::targets::{script, sdo, segment};

/// The inputs for a target.
pub fn of(target: &str) -> Vec<Vec<u8>> {
    let messages = messages();
    let payloads = || messages.iter().filter_map(|message| message.get(8..));
    match target {
        "message" => {
            let mut seeds = messages;
            seeds.push([&[10, 0, 0, 0, 0, 0x13, 0, 0x10][..], &[0x11, 0x86, 0x21, 1, 2, 3, 4, 5]].concat());
            seeds.push(vec![4, 0, 0, 0, 0, 0x20, 1, 0, 4, 0]);
            seeds
        }
        "sdo" => transfers(),
        "information" => questions(),
        "client" => {
            let mut seeds: Vec<_> = (0..8u8)
                .map(|first| {
                    // Every other access is a write that is taken; each read brings the next reply.
                    let mut script = vec![first];
                    for payload in payloads().take(40) {
                        script.extend([0, 3, payload.len() as u8]);
                        script.extend(payload);
                    }
                    script
                })
                .collect();
            seeds.push(vec![0]);
            seeds
        }
        "sii" => vec![eeprom()],
        "esi" => vec![
            include_bytes!("../../sim/esi/generic.xml").to_vec(),
            include_bytes!("../../sim/esi/akd2g.xml").to_vec(),
            br##"<?xml version="1.0" encoding="ISO-8859-1"?><EtherCATInfo><Vendor><Id>1</Id><Name>x</Name></Vendor><Descriptions><Devices><Device><Type ProductCode="#x2" RevisionNo="1">D</Type><RxPdo Fixed="1" Mandatory="true" Sm="2"><Index>#x1701</Index><Exclude>#x1702</Exclude><Entry><Index>#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry></RxPdo></Device></Devices></Descriptions></EtherCATInfo>"##.to_vec(),
        ],
        "toml" => vec![
            // Tables within tables: what takes most memory for each byte.
            (0..50).fold(b"\0".to_vec(), |mut file, number| {
                file.extend(format!("[{number}.a.a.a.a.a.a.a.a.a.a.a.a]\n").bytes());
                file
            }),
            b"\0drive = \"left\"\n[[write]]\nobject = \"quick stop deceleration\"\naxis = 2\nvalue = 1_000_000\ncomment = \"full load\"\nverify = true\n[[write]]\nobject = \"2345h:0A\"\ntype = \"bytes\"\nvalue = [1, 0xFF]\ntransition = \"SAFEOP-OP\"\n".to_vec(),
            b"\x01drive = \"left\"\n[identity]\nvendor = 0x6A\nproduct = 1\nrevision = 2\nserial = 3\n[[parameter]]\nobject = \"2345h:01\"\nname = \"n\"\ntype = \"i16\"\nvalue = -7\n[[parameter]]\nobject = \"6067h:00\"\nvalue = 50\n[[parameter]]\nobject = \"2346h:01\"\ntype = \"f32\"\nvalue = 1.5\n[[parameter]]\nobject = \"2347h:01\"\ntype = \"string\"\nvalue = 'x'\n".to_vec(),
        ],
        "bus" => vec![
            Vec::new(),
            vec![1, 9, 26, 4, 0xFF, 0xFF, 0xFF, 0xFF, 20, 9, 26, 8, 0, 0, 0, 0, 0, 0, 0, 0],
            vec![30, 0, 30, 1, 30, 2, 30, 3, 20, 30, 4, 200, 30, 5, 30],
            vec![200, 9, 16, 2, 0, 0, 100, 9, 30, 1, 0, 100, 9, 40, 3, 1, 2, 3],
        ],
        "segment" => {
            let mut seeds = vec![script(&[], [])];
            for message in messages.iter().take(20) {
                seeds.push([&[15][..], &script(&[], [message.as_slice()])].concat());
            }
            let frame = segment::frame(7, 0, 0x0130, &[0; 2]);
            seeds.push([&[0][..], &script(&[], [frame.as_slice()])].concat());
            seeds.push(vec![4, 1, 0x10, 0, 9, 16, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 17, 50]);
            seeds
        }
        _ => panic!("no target {target}"),
    }
}

/// Both directions of the recorded dialogues.
fn messages() -> Vec<Vec<u8>> {
    let columns = |table: &'static str, from: usize| {
        table
            .lines()
            .filter(|line| !line.starts_with('#') && !line.trim().is_empty())
            .flat_map(move |line| line.split('|').skip(from).take(2).map(bytes))
    };
    columns(include_str!("../vectors/akd_sdo_mails.txt"), 2)
        .chain(columns(include_str!("../vectors/pp_drive_mails.txt"), 1))
        .filter(|message| message.len() <= 255)
        .collect()
}

/// Transfers of the object that the target asks for: expedited, in the first reply, in segments, aborted.
fn transfers() -> Vec<Vec<u8>> {
    let [i0, i1] = sdo::OBJECT.index.to_le_bytes();
    let reply = |command: u8, data: &[u8]| [&[command, i0, i1, 0][..], data].concat();
    let segments: Vec<Vec<u8>> = vec![
        reply(0x41, &[16, 0, 0, 0, b'A', b'K']),
        b"\x00D2G Eth".to_vec(),
        b"\x10erCAT D\x00".to_vec(),
    ];
    let writes: Vec<Vec<u8>> = vec![
        reply(0x60, &[0; 4]),
        vec![0x20, 0, 0, 0, 0, 0, 0, 0],
        vec![0x30, 0, 0, 0, 0, 0, 0, 0],
        vec![0x20, 0, 0, 0, 0, 0, 0, 0],
    ];
    let parts = |parts: &[Vec<u8>], head: &[u8]| script(head, parts.iter().map(Vec::as_slice));
    vec![
        parts(&[reply(0x4B, &[0x37, 0x16, 0, 0])], &[0]),
        parts(&[reply(0x42, &[0x37, 0x16, 0, 0])], &[4, 2]),
        parts(&[reply(0x41, &[3, 0, 0, 0, 1, 2, 3])], &[2]),
        parts(&segments, &[0]),
        parts(&[reply(0x41, &[0xFF, 0xFF, 0xFF, 0xFF])], &[0]),
        parts(
            &[
                reply(0x41, &[0, 0, 0x10, 0]),
                b"\x0E\0\0\0\0\0\0\0".to_vec(),
            ],
            &[0],
        ),
        parts(&[reply(0x80, &[0, 0, 2, 6])], &[0]),
        parts(&writes, &[1, 2, 0, 16, 0]),
        parts(&writes, &[1, 30, 0, 20, 0]),
        parts(&writes, &[3, 40, 0, 24, 0]),
    ]
}

/// A list in two fragments, and descriptions as ETG.1000.6 lays them out.
fn questions() -> Vec<Vec<u8>> {
    let parts = |question: u8, parts: &[&[u8]]| script(&[question], parts.iter().copied());
    vec![
        parts(0, &[b"\x02\0\0\0\0\0\x10\0\x01\0\x02\0\x03\0\x04\0"]),
        parts(1, &[b"\x82\0\x01\0\x01\0\x00\x10\x01\x10", b"\x02\0\0\0\x18\x10"]),
        parts(1, &[b"\x82\0\xFF\xFF\x01\0\x00\x10", b"\x82\0\xFE\xFF\x01\x10"]),
        parts(3, &[b"\x04\0\0\0\x18\x10\x23\0\x04\x09Identity"]),
        parts(4, &[b"\x06\0\0\0\x18\x10\x01\x78\x07\0\x20\0\x07\0\0\0\0\0\x6A\0\0\0\0\0\0\0\xFF\xFF\xFF\xFFVendor"]),
        parts(5, &[b"\x06\0\0\0\x81\x60\0\0\x07\0\x20\0\x3F\0Profile velocity"]),
        parts(3, &[b"\x07\0\0\0\0\0\x02\x06"]),
    ]
}

fn eeprom() -> Vec<u8> {
    include_str!("../vectors/akd_eeprom.txt")
        .lines()
        .filter(|line| !line.starts_with('#'))
        .filter_map(|line| line.split_once('|'))
        .flat_map(|(_, row)| bytes(row))
        .collect()
}

/// Hexadecimal bytes with spaces between them; `7A*5` is five times 7Ah.
fn bytes(text: &str) -> Vec<u8> {
    text.split_whitespace()
        .flat_map(|part| {
            let (byte, times) = part.split_once('*').unwrap_or((part, "1"));
            let byte = u8::from_str_radix(byte, 16).expect("a hexadecimal byte");
            vec![byte; times.parse().expect("a number of times")]
        })
        .collect()
}
