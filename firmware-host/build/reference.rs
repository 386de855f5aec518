//! From doc comments to the table of types that `src/config/reference` includes.
//!
//! Types are found by name, which the whole project uses once each. A type that is written by another one is
//! described by that: `PoseFields` for `Pose`.

use std::collections::BTreeMap;
use std::error::Error;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use syn::punctuated::Punctuated;
use syn::{
    Attribute, Expr, ExprLit, Fields, FieldsNamed, GenericArgument, Item, ItemEnum, Lit, Meta, PathArguments,
    Token, Type,
};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Types that files hold as a whole.
const ROOTS: [&str; 2] = ["Config", "Rig"];
/// Where the settings' types are declared.
const SOURCES: [&str; 3] = ["src", "../crates/gelstereo-core/src", "../crates/gelstereo-sim/src"];

/// All types by name; some names are used by several that no file holds.
type Types = BTreeMap<String, Vec<Result<TypeDoc>>>;

#[derive(Default)]
struct TypeDoc {
    doc: String,
    tag: Option<String>,
    fields: Vec<FieldDoc>,
    variants: Vec<VariantDoc>,
}

struct VariantDoc {
    name: String,
    doc: String,
    fields: Vec<FieldDoc>,
    /// Type whose keys stand in the variant's table.
    inner: Option<String>,
}

struct FieldDoc {
    key: String,
    doc: String,
    type_name: String,
    optional: bool,
}

/// Writes `$OUT_DIR/config_reference.rs`.
pub fn generate() -> Result<()> {
    let here = PathBuf::from(std::env::var("CARGO_MANIFEST_DIR")?);
    let mut types = Types::new();
    for source in SOURCES {
        let folder = here.join(source);
        println!("cargo:rerun-if-changed={}", folder.display());
        collect(&folder, &mut types)?;
    }
    println!("cargo:rerun-if-changed=build");
    let mut reachable = BTreeMap::new();
    for root in ROOTS {
        reach(root, &mut types, &mut reachable)?;
    }
    let out = PathBuf::from(std::env::var("OUT_DIR")?).join("config_reference.rs");
    std::fs::write(out, text(&reachable)?)?;
    Ok(())
}

fn collect(folder: &Path, types: &mut Types) -> Result<()> {
    let mut entries = std::fs::read_dir(folder)?.collect::<std::io::Result<Vec<_>>>()?;
    entries.sort_by_key(std::fs::DirEntry::path);
    for path in entries.into_iter().map(|entry| entry.path()) {
        if path.is_dir() {
            collect(&path, types)?;
            continue;
        }
        let source = std::fs::read_to_string(&path)?;
        // Most files declare no settings; they need not be parsed.
        if path.extension().is_some_and(|e| e == "rs") && source.contains("Deserialize") {
            let file = syn::parse_file(&source).map_err(|error| format!("{}: {error}", path.display()))?;
            for (name, doc) in file.items.into_iter().filter_map(item_doc) {
                types.entry(name).or_default().push(doc);
            }
        }
    }
    Ok(())
}

/// The name and description of a type that files hold; the fault, if it is written in a way that is not read
/// here.
fn item_doc(item: Item) -> Option<(String, Result<TypeDoc>)> {
    match item {
        Item::Struct(item) if is_read(&item.attrs) => {
            let Fields::Named(fields) = &item.fields else { return None };
            let fields = fields_doc(fields);
            let of = fields.map(|fields| TypeDoc { doc: doc(&item.attrs), fields, ..TypeDoc::default() });
            Some((item.ident.to_string(), of))
        }
        Item::Enum(item) if is_read(&item.attrs) => Some((item.ident.to_string(), enum_doc(&item))),
        // The simulator lists its effects once, in a macro.
        Item::Macro(item) if item.mac.path.is_ident("effects") => {
            Some(("Effects".to_owned(), effects_doc(&item.mac.tokens.to_string())))
        }
        _ => None,
    }
}

fn enum_doc(item: &ItemEnum) -> Result<TypeDoc> {
    let of = serde_words(&item.attrs)?;
    if let Some(case) = of.get("rename_all").filter(|case| *case != "snake_case") {
        return Err(format!("{}: rename_all = \"{case}\" is not read here", item.ident).into());
    }
    let variants = item.variants.iter().map(|variant| {
        let (fields, inner) = match &variant.fields {
            Fields::Named(fields) => (fields_doc(fields)?, None),
            Fields::Unnamed(one) if one.unnamed.len() == 1 => (Vec::new(), Some(peel(&one.unnamed[0].ty)?.0)),
            _ => (Vec::new(), None),
        };
        let renamed = serde_words(&variant.attrs)?.remove("rename");
        let name = renamed.unwrap_or_else(|| snake_case(&variant.ident.to_string()));
        Ok(VariantDoc { name, doc: doc(&variant.attrs), fields, inner })
    });
    let variants = variants.collect::<Result<Vec<_>>>()?;
    Ok(TypeDoc { doc: doc(&item.attrs), tag: of.get("tag").cloned(), fields: Vec::new(), variants })
}

fn effects_doc(tokens: &str) -> Result<TypeDoc> {
    let fields: FieldsNamed = syn::parse_str(&format!("{{ {tokens} }}"))?;
    let mut fields = fields_doc(&fields)?;
    fields.iter_mut().for_each(|field| field.optional = true);
    Ok(TypeDoc { fields, ..TypeDoc::default() })
}

/// Whether serde's derive reads the type.
fn is_read(attrs: &[Attribute]) -> bool {
    attrs.iter().any(|attr| {
        let tokens = match &attr.meta {
            Meta::List(list) if list.path.is_ident("derive") || list.path.is_ident("cfg_attr") => {
                &list.tokens
            }
            _ => return false,
        };
        tokens.to_string().contains("Deserialize")
    })
}

fn fields_doc(fields: &FieldsNamed) -> Result<Vec<FieldDoc>> {
    let mut all = Vec::new();
    for field in &fields.named {
        let words = serde_words(&field.attrs)?;
        let name = field.ident.as_ref().map(ToString::to_string).unwrap_or_default();
        if words.contains_key("flatten") {
            return Err(format!("{name}: serde(flatten) is not read here").into());
        }
        if words.contains_key("skip") {
            continue;
        }
        let (type_name, optional) = peel(&field.ty)?;
        let key = words.get("rename").cloned().unwrap_or(name);
        all.push(FieldDoc { key, doc: doc(&field.attrs), type_name, optional });
    }
    Ok(all)
}

/// The innermost type's name, and whether it is an option.
fn peel(ty: &Type) -> Result<(String, bool)> {
    match ty {
        Type::Array(array) => peel(&array.elem),
        Type::Path(path) => {
            let last = path.path.segments.last().ok_or("a type without a name")?;
            let inner = match &last.arguments {
                PathArguments::AngleBracketed(arguments) => match arguments.args.first() {
                    Some(GenericArgument::Type(inner)) => Some(inner),
                    _ => None,
                },
                _ => None,
            };
            match (last.ident.to_string().as_str(), inner) {
                ("Option", Some(inner)) => peel(inner).map(|(name, _)| (name, true)),
                ("Vec" | "Box", Some(inner)) => peel(inner),
                (name, _) => Ok((name.to_owned(), false)),
            }
        }
        _ => Err("a setting is a named type, a list of such, or an option".into()),
    }
}

/// Doc comment as one text, paragraphs apart.
fn doc(attrs: &[Attribute]) -> String {
    let mut text = String::new();
    for attr in attrs {
        let Meta::NameValue(pair) = &attr.meta else { continue };
        let Expr::Lit(ExprLit { lit: Lit::Str(line), .. }) = &pair.value else { continue };
        if pair.path.is_ident("doc") {
            let line = line.value().trim().to_owned();
            let gap = if line.is_empty() || text.is_empty() || text.ends_with('\n') { "" } else { " " };
            text += gap;
            text += if line.is_empty() { "\n" } else { &line };
        }
    }
    text.trim().to_owned()
}

/// What `#[serde(..)]` and `#[cfg_attr(.., serde(..))]` say, with their texts.
fn serde_words(attrs: &[Attribute]) -> Result<BTreeMap<String, String>> {
    let mut words = BTreeMap::new();
    let mut read = |list: &syn::MetaList| -> Result<()> {
        for meta in list.parse_args_with(Punctuated::<Meta, Token![,]>::parse_terminated)? {
            let name = meta.path().get_ident().map(ToString::to_string).unwrap_or_default();
            let text = match &meta {
                Meta::NameValue(pair) => match &pair.value {
                    Expr::Lit(ExprLit { lit: Lit::Str(text), .. }) => text.value(),
                    _ => String::new(),
                },
                _ => String::new(),
            };
            words.insert(name, text);
        }
        Ok(())
    };
    for attr in attrs {
        let Meta::List(list) = &attr.meta else { continue };
        if list.path.is_ident("serde") {
            read(list)?;
        } else if list.path.is_ident("cfg_attr") {
            for meta in list.parse_args_with(Punctuated::<Meta, Token![,]>::parse_terminated)? {
                match &meta {
                    Meta::List(inner) if inner.path.is_ident("serde") => read(inner)?,
                    _ => {}
                }
            }
        }
    }
    Ok(words)
}

fn snake_case(name: &str) -> String {
    let mut out = String::new();
    for c in name.chars() {
        if c.is_uppercase() && !out.is_empty() {
            out.push('_');
        }
        out.extend(c.to_lowercase());
    }
    out
}

/// Moves a type and all that it holds over to `reachable`.
fn reach(name: &str, types: &mut Types, reachable: &mut BTreeMap<String, TypeDoc>) -> Result<()> {
    if reachable.contains_key(name) {
        return Ok(());
    }
    let Some(mut found) = types.remove(&format!("{name}Fields")).or_else(|| types.remove(name)) else {
        return Ok(()); // a number, a text or the like
    };
    if found.len() > 1 {
        return Err(
            format!("{} types of the configuration are named {name}; valid is one", found.len()).into()
        );
    }
    let Some(found) = found.pop().transpose()? else { return Ok(()) };
    let fields = found.fields.iter().chain(found.variants.iter().flat_map(|variant| &variant.fields));
    let in_variants = found.variants.iter().filter_map(|variant| variant.inner.clone());
    let inner: Vec<String> = fields.map(|field| field.type_name.clone()).chain(in_variants).collect();
    reachable.insert(name.to_owned(), found);
    inner.iter().try_for_each(|name| reach(name, types, reachable))
}

/// The table as Rust source.
fn text(types: &BTreeMap<String, TypeDoc>) -> Result<String> {
    let fields = |fields: &[FieldDoc]| {
        let one = |f: &FieldDoc| {
            format!(
                "FieldDoc {{ key: {:?}, doc: {:?}, type_name: {:?}, optional: {} }}, ",
                f.key, f.doc, f.type_name, f.optional
            )
        };
        format!("&[{}]", fields.iter().map(one).collect::<String>())
    };
    let mut out = String::from("&[\n");
    for (name, of) in types {
        let variants: String = of
            .variants
            .iter()
            .map(|v| {
                let inner = v.inner.as_ref().and_then(|name| types.get(name));
                let keys = fields(inner.map_or(&v.fields, |inner| &inner.fields));
                format!("VariantDoc {{ name: {:?}, doc: {:?}, fields: {keys} }}, ", v.name, v.doc)
            })
            .collect();
        writeln!(
            out,
            "TypeDoc {{ name: {name:?}, doc: {:?}, tag: {:?}, fields: {}, variants: &[{variants}] }},",
            of.doc,
            of.tag,
            fields(&of.fields)
        )?;
    }
    out += "]\n";
    Ok(out)
}
