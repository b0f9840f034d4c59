// What the form needs to know about a place of the JSON schema, whatever the section is.

const UNIT = /\(([^()]+)\)\?\\s\*\$$/;

/** The schema behind `$ref`, with the description and the default of where it is used. */
export function resolve(schema, root) {
  let found = schema || {};
  for (let depth = 0; found.$ref && depth < 16; depth += 1) {
    const { $ref, ...own } = found;
    const target = $ref.split("/").slice(1).reduce((at, part) => (at || {})[part], root) || {};
    found = { ...target, ...own };
  }
  return found;
}

/**
 * What a value may be: `kind` is object, list, map, union, scalar or json, with `schema` (of an object), `items` (of a list or map),
 * `types` (of a union, by value of `tag`), or `choice` (of a scalar).
 */
export function describe(schema, root, value) {
  const found = resolve(schema, root);
  const union = unionOf(found, root);
  if (union) return union;
  const given = found.anyOf || found.oneOf;
  const all = (given || [found]).filter((one) => !isVariable(one)).map((one) => resolve(one, root));
  const nullable = all.some((one) => one.type === "null");
  const choices = all.filter((one) => one.type !== "null");
  const about = { description: found.description || "", default: found.default, nullable };
  const section = choices.find((one) => one.type === "object");
  const list = choices.find((one) => one.type === "array");
  const plain = choices.filter((one) => one.type !== "object" && one.type !== "array");
  if (section && !(plain.length && value !== undefined && !isObject(value))) {
    const what = { ...about, schema: section, description: about.description || section.description || "" };
    if (section.properties && Object.keys(section.properties).length) return { ...what, kind: "object" };
    const items = section.additionalProperties;
    return isObject(items) ? { ...what, kind: "map", items } : { ...what, kind: "json" };
  }
  if (list && plain.length === 0) return { ...about, kind: isObject(list.items) ? "list" : "json", items: list.items };
  return { ...about, kind: "scalar", choice: scalar(plain) };
}

function unionOf(found, root) {
  const options = found.oneOf || found.anyOf;
  if (!options) return null;
  const sections = options.map((one) => resolve(one, root));
  if (!sections.every((one) => one.properties)) return null;
  const tag = found.discriminator?.propertyName
    || Object.keys(sections[0].properties).find((key) => sections.every((one) => one.properties[key]?.const !== undefined));
  if (!tag) return null;
  const types = Object.fromEntries(sections.map((one) => [one.properties[tag].const, one]));
  return { kind: "union", tag, types, description: found.description || "" };
}

function scalar(plain) {
  const types = new Set(plain.map((one) => one.type));
  const words = plain.flatMap((one) => one.enum || (one.const === undefined ? [] : [one.const]));
  const unit = plain.map((one) => UNIT.exec(one.pattern || "")).find((one) => one);
  const text = plain.some((one) => one.type === "string" && !UNIT.test(one.pattern || "") && !one.enum && one.const === undefined);
  const number = types.has("number") || types.has("integer");
  const limits = plain.find((one) => one.minimum !== undefined || one.maximum !== undefined) || {};
  return { words, boolean: types.has("boolean"), number, text, units: unit ? unit[1].split("|") : [], limits };
}

/** The value that a text in a field means; undefined removes it. */
export function valueOf(text, choice) {
  if (text === "") return undefined;
  const typed = choice.number || choice.boolean;
  if (text.includes("${") && !choice.text) return typed ? { $unquoted: text } : text;
  if (choice.number && /^[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)$/.test(text.trim())) return Number(text);
  if (choice.boolean && (text === "true" || text === "false")) return text === "true";
  return text;
}

/** As the messages of PHM name a place: `containers[0].files[1].path`. */
export function dotted(path) {
  return path.reduce((text, part) => (typeof part === "number" ? `${text}[${part}]` : text ? `${text}.${part}` : part), "");
}

export function isObject(value) {
  return value !== null && typeof value === "object" && !Array.isArray(value);
}

function isVariable(schema) {
  return schema.$ref === "#/$defs/Variable";
}
