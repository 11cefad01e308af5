//! A row of `drives.json`.

use serde_json::Value;

/// An object of an axis, and whether it is in the process data.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    pub index: u16,
    pub bytes: usize,
    pub signed: bool,
    pub mapped: bool,
}

impl Field {
    /// `6040 U16`, or `6060 I8 sdo` for one that is not mapped.
    fn parse(row: &str, offset: u16) -> Self {
        let mut words = row.split_whitespace();
        let index = hexadecimal(words.next().expect("an index")) as u16 + offset;
        let kind = words.next().expect("a type");
        let bits: usize = kind[1..].parse().expect("bits");
        Self {
            index,
            bytes: bits / 8,
            signed: kind.starts_with('I'),
            mapped: words.next().is_none(),
        }
    }

    pub fn pack(self, value: i64) -> Vec<u8> {
        value.to_le_bytes()[..self.bytes].to_vec()
    }

    pub fn unpack(self, data: &[u8]) -> i64 {
        let mut bytes = [0; 8];
        bytes[..self.bytes].copy_from_slice(&data[..self.bytes]);
        let unused = 64 - 8 * self.bytes as u32;
        let value = i64::from_le_bytes(bytes) << unused;
        if self.signed {
            value >> unused
        } else {
            (value.cast_unsigned() >> unused) as i64
        }
    }
}

/// An axis: its PDOs and what is in them.
#[derive(Clone, Debug)]
pub struct Axis {
    pub offset: u16,
    pub rx: u16,
    pub tx: u16,
    pub outputs: Vec<Field>,
    pub inputs: Vec<Field>,
}

/// What a drive should answer.
#[derive(Clone, Debug)]
pub struct Drive {
    pub identity: [u32; 3],
    pub order: String,
    pub name: String,
    pub text_object: (u16, usize),
    pub complete_access: bool,
    pub window: i64,
    pub startup: Vec<(u16, u8, Vec<u8>)>,
    pub axes: Vec<Axis>,
}

impl Drive {
    /// The row of this name in the table.
    pub fn named(table: &str, name: &str) -> Self {
        let table: Value = serde_json::from_str(table).expect("JSON");
        let row = table.get(name).expect("a drive of the table");
        let text = |value: &Value| value.as_str().expect("text").to_owned();
        let list = |value: &Value| value.as_array().expect("a list").clone();
        let hex = |value: &Value| hexadecimal(&text(value));
        let axis = |axis: Value| {
            let offset = hex(&axis["offset"]) as u16;
            let fields = |side: &str| {
                list(&row[side])
                    .iter()
                    .map(|field| Field::parse(&text(field), offset))
                    .collect()
            };
            Axis {
                offset,
                rx: hex(&axis["rx"]) as u16,
                tx: hex(&axis["tx"]) as u16,
                outputs: fields("outputs"),
                inputs: fields("inputs"),
            }
        };
        let startup = |write: Value| {
            let kind = format!("{} {}", text(&write[0]), text(&write[2]));
            let field = Field::parse(&kind, 0);
            let subindex = write[1].as_u64().expect("a subindex") as u8;
            let value = write[3].as_i64().expect("a value");
            (field.index, subindex, field.pack(value))
        };
        let bytes = row["text_object"]["bytes"].as_u64().expect("a number");
        Self {
            identity: ["vendor", "product", "revision"].map(|key| hex(&row[key])),
            order: text(&row["order"]),
            name: text(&row["name"]),
            text_object: (hex(&row["text_object"]["index"]) as u16, bytes as usize),
            complete_access: row["complete_access"].as_bool().expect("a truth"),
            window: row["window"].as_i64().unwrap_or(10),
            startup: list(&row["startup"]).into_iter().map(startup).collect(),
            axes: list(&row["axes"]).into_iter().map(axis).collect(),
        }
    }
}

fn hexadecimal(text: &str) -> u32 {
    u32::from_str_radix(text, 16).expect("hexadecimal")
}
