//! A report as blocks: written as Markdown with its figures and one CSV a table, and as one self-contained HTML page.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use std::fmt::Write as _;
use std::path::Path;

/// A cell of a table.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// Words.
    Text(String),
    /// A number, shown with so many decimals; the CSV has all its digits.
    Number(f64, usize),
    /// Nothing was measured.
    Missing,
}

impl Cell {
    /// A count.
    #[must_use]
    pub fn count(count: u64) -> Self {
        Self::Number(count as f64, 0)
    }

    /// A number that may not have been measured.
    #[must_use]
    pub fn known(value: Option<f64>, decimals: usize) -> Self {
        value.map_or(Self::Missing, |value| Self::Number(value, decimals))
    }

    fn shown(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Number(value, decimals) => format!("{value:.decimals$}"),
            Self::Missing => "-".to_owned(),
        }
    }

    fn csv(&self) -> String {
        match self {
            Self::Text(text) if text.contains([',', '"', '\n']) => format!("\"{}\"", text.replace('"', "\"\"")),
            Self::Text(text) => text.clone(),
            Self::Number(value, _) => value.to_string(),
            Self::Missing => String::new(),
        }
    }
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

/// A table; each row has a cell a column.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Stem of its CSV file.
    pub name: &'static str,
    /// What it shows, in a sentence.
    pub caption: String,
    /// Heads of the columns, with units.
    pub columns: Vec<String>,
    /// The rows.
    pub rows: Vec<Vec<Cell>>,
}

impl Table {
    /// A table without rows yet.
    #[must_use]
    pub fn new(name: &'static str, caption: impl Into<String>, columns: &[&str]) -> Self {
        let columns = columns.iter().map(|column| (*column).to_owned()).collect();
        Self { name, caption: caption.into(), columns, rows: Vec::new() }
    }

    /// The table as CSV (RFC 4180).
    #[must_use]
    pub fn csv(&self) -> String {
        let line = |cells: Vec<String>| cells.join(",") + "\r\n";
        let heads = self.columns.iter().map(|column| Cell::from(column.as_str()).csv()).collect();
        let rows = self.rows.iter().map(|row| line(row.iter().map(Cell::csv).collect()));
        line(heads) + &rows.collect::<String>()
    }
}

/// A part of a report.
#[derive(Debug, Clone, PartialEq)]
pub enum Block {
    /// A section's head.
    Head(String),
    /// A paragraph.
    Text(String),
    /// A table.
    Table(Table),
    /// A picture.
    Figure {
        /// Stem of its PNG file.
        name: &'static str,
        /// What it shows.
        caption: String,
        /// The PNG file.
        png: Vec<u8>,
    },
}

/// A report under its title.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// The title.
    pub title: String,
    /// The parts.
    pub blocks: Vec<Block>,
}

impl Report {
    /// Writes `report.md`, `report.html`, and a PNG or CSV file a figure or table into a folder, which must be there.
    ///
    /// # Errors
    /// Those of the files.
    pub fn write(&self, folder: &Path) -> std::io::Result<()> {
        for block in &self.blocks {
            match block {
                Block::Figure { name, png, .. } => std::fs::write(folder.join(format!("{name}.png")), png)?,
                Block::Table(table) => std::fs::write(folder.join(format!("{}.csv", table.name)), table.csv())?,
                Block::Head(_) | Block::Text(_) => {}
            }
        }
        std::fs::write(folder.join("report.md"), self.markdown())?;
        std::fs::write(folder.join("report.html"), self.html())
    }

    /// The report in Markdown, its figures as files beside it.
    #[must_use]
    pub fn markdown(&self) -> String {
        let mut text = format!("# {}\n", self.title);
        for block in &self.blocks {
            text.push('\n');
            // A text in memory takes what is written to it.
            let _ = match block {
                Block::Head(head) => writeln!(text, "## {head}"),
                Block::Text(paragraph) => writeln!(text, "{paragraph}"),
                Block::Figure { name, caption, .. } => writeln!(text, "![{caption}]({name}.png)\n\n*{caption}*"),
                Block::Table(table) => {
                    let row = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
                    let rule = table.columns.iter().map(|_| "---".to_owned()).collect();
                    let rows = table.rows.iter().map(|cells| row(cells.iter().map(Cell::shown).collect()));
                    let body = row(table.columns.clone()) + &row(rule) + &rows.collect::<String>();
                    writeln!(text, "{} ([CSV]({}.csv))\n\n{}", table.caption, table.name, body.trim_end())
                }
            };
        }
        text
    }

    /// The report as one page that needs no other file.
    #[must_use]
    pub fn html(&self) -> String {
        let title = escape(&self.title);
        let mut text = format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<title>{title}</title>\n<style>{STYLE}</style>\n\
             </head>\n<body>\n<h1>{title}</h1>\n"
        );
        for block in &self.blocks {
            let _ = match block {
                Block::Head(head) => writeln!(text, "<h2>{}</h2>", escape(head)),
                Block::Text(paragraph) => writeln!(text, "<p>{}</p>", escape(paragraph)),
                Block::Figure { caption, png, .. } => {
                    let (data, caption) = (BASE64_STANDARD.encode(png), escape(caption));
                    writeln!(
                        text,
                        "<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{data}\"><figcaption>{caption}</figcaption></figure>"
                    )
                }
                Block::Table(table) => writeln!(text, "{}", html_table(table)),
            };
        }
        text + "</body>\n</html>\n"
    }
}

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem}\
table{border-collapse:collapse;margin:1rem 0}caption{text-align:left;font-style:italic}\
td,th{border:1px solid #bbb;padding:.2rem .6rem}td.n{text-align:right}figure{margin:1rem 0}img{max-width:100%}\
figcaption{font-style:italic}";

fn html_table(table: &Table) -> String {
    let heads: String = table.columns.iter().map(|column| format!("<th>{}</th>", escape(column))).collect();
    let cell = |cell: &Cell| {
        let class = if matches!(cell, Cell::Number(..)) { " class=\"n\"" } else { "" };
        format!("<td{class}>{}</td>", escape(&cell.shown()))
    };
    let row = |row: &Vec<Cell>| format!("<tr>{}</tr>\n", row.iter().map(cell).collect::<String>());
    let rows: String = table.rows.iter().map(row).collect();
    format!("<table><caption>{}</caption>\n<tr>{heads}</tr>\n{rows}</table>", escape(&table.caption))
}

/// Text without what HTML gives a meaning to; code marks of Markdown are dropped.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;").replace('`', "")
}
