//! An MCAP file, read from front to back: one that a crash cut off is read up to there.

use super::file::{LONGEST_RECORD, LONGEST_TOPIC, MOST_TOPICS, Message, Topic};
use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::HashMap;
use std::io::{ErrorKind, Read};
use std::sync::Arc;

/// Bytes asked for at least at a time.
const LEAST_READ: usize = 64 << 10;

/// Bytes asked for at most at a time: what a record says of its length may be wrong.
const MOST_READ: usize = 1 << 20;

/// A file that is being read.
pub(super) struct McapFile {
    source: Box<dyn Read + Send>,
    reader: LinearReader,
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, Arc<Topic>>,
}

/// Messages: record 5.
const MESSAGE: u8 = 0x05;

/// Channel, sequence and two times before a message's data.
const MESSAGE_HEADER: usize = 22;

impl McapFile {
    pub(super) fn new(source: impl Read + Send + 'static) -> Self {
        let options =
            LinearReaderOptions::default().with_prevalidate_chunk_crcs(true).with_record_length_limit(LONGEST_RECORD);
        Self {
            source: Box::new(source),
            reader: LinearReader::new_with_options(options),
            schemas: HashMap::new(),
            channels: HashMap::new(),
        }
    }

    pub(super) fn topics(&self) -> Vec<Arc<Topic>> {
        self.channels.values().cloned().collect()
    }

    pub(super) fn next_message(&mut self) -> Result<Option<Message>, String> {
        while let Some(event) = self.reader.next_event() {
            match event.map_err(|error| told(&error))? {
                LinearReadEvent::ReadRequest(need) => {
                    let into = self.reader.insert(need.clamp(LEAST_READ, MOST_READ));
                    let count = loop {
                        match self.source.read(into) {
                            Err(error) if error.kind() == ErrorKind::Interrupted => {}
                            other => break other.map_err(|error| error.to_string())?,
                        }
                    };
                    self.reader.notify_read(count);
                }
                LinearReadEvent::Record { opcode: MESSAGE, data } => {
                    let Some((head, data)) = data.split_at_checked(MESSAGE_HEADER) else {
                        return Err("a message is shorter than its header".to_owned());
                    };
                    let channel = u16::from_le_bytes([head[0], head[1]]);
                    let Some(topic) = self.channels.get(&channel) else {
                        return Err(format!("a message is of channel {channel}, which no record before it describes"));
                    };
                    if let Some(kind) = topic.kind {
                        return Ok(Some(Message { topic: Arc::clone(topic), kind, data: data.to_vec() }));
                    }
                }
                LinearReadEvent::Record { opcode, data } => {
                    let record = mcap::parse_record(opcode, data).map_err(|error| told(&error))?;
                    note(&record, &mut self.schemas, &mut self.channels)?;
                }
            }
        }
        Ok(None)
    }
}

/// Takes note of types and topics.
fn note(
    record: &Record<'_>,
    schemas: &mut HashMap<u16, String>,
    channels: &mut HashMap<u16, Arc<Topic>>,
) -> Result<(), String> {
    match record {
        Record::Schema { header, .. } => {
            let name = header.name.chars().take(LONGEST_TOPIC).collect();
            schemas.insert(header.id, name);
        }
        // The summary behind the data repeats them.
        Record::Channel(channel) if !channels.contains_key(&channel.id) => {
            if channels.len() >= MOST_TOPICS {
                return Err(format!("has more than {MOST_TOPICS} topics"));
            }
            let type_name = schemas.get(&channel.schema_id).map_or("", String::as_str);
            let topic = Topic::new(&channel.topic, type_name, &channel.message_encoding);
            channels.insert(channel.id, Arc::new(topic));
        }
        _ => {}
    }
    Ok(())
}

fn told(error: &mcap::McapError) -> String {
    match error {
        mcap::McapError::UnexpectedEof => "the MCAP file ends in the middle of a record: it was cut off".to_owned(),
        error => format!("the MCAP file is damaged: {error}"),
    }
}
