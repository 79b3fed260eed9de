// Languages. The page is written in English, and each text is looked up when it is shown.
//
// t`Line ${number}: ${text}` looks "Line {0}: {1}" up; translated(text) does so for a text from data.
// Texts in HTML are replaced once, here. A text that is missing in a table stays English.

const LANGUAGE_AS = "ugrbl-language", ENGLISH = ["English"];
/** steps: from the number of one text to that of the next; languages: by code, a language's name and then its texts. */
const { multiplier, steps: numberSteps, languages } = JSON.parse(document.getElementById("texts").textContent);
const language = chosenLanguage();
let lastNumber = 0;
const TEXTS = new Map((languages[language] || ENGLISH).slice(1).map((text, index) => [lastNumber += numberSteps[index], text]));

/** The language selected before, or else the first one of the browser's that the page has. */
function chosenLanguage() {
  let selected = "";
  try {
    selected = localStorage.getItem(LANGUAGE_AS) || "";
  } catch (error) {
    console.info("no language is stored:", error.message);
  }
  const codes = [selected, ...navigator.languages].map((code) => code.slice(0, 2));
  return codes.find((code) => code === "en" || code in languages) || "en";
}

/** The number by which a text is found: tools/boardfile/page_texts.py computes it, too. */
function numberOf(text) {
  let number = 0;
  for (let at = 0; at < text.length; at += 1) number = (number * multiplier + text.charCodeAt(at)) & 0x1ffff;
  return number;
}

/** A text in the page's language; undefined stays undefined. */
function translated(text) { return text && TEXTS.get(numberOf(text)) || text; }

/** A template in the page's language, with its values. */
function t(parts, ...values) {
  const text = parts.map((part, index) => (index ? `{${index - 1}}${part}` : part)).join("");
  return translated(text).replace(/\{(\d)\}/g, (_, index) => values[index]);
}

/** Translate the texts and attributes of the page itself. */
function translatePage() {
  const said = (text) => (/[A-Za-z]{2}/.test(text) ? translated(text.replace(/\s+/g, " ")) : text);
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_ELEMENT | NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode;
    if (/^(SCRIPT|STYLE)$/.test((node.parentNode || node).tagName)) continue;
    if (node.nodeType === Node.TEXT_NODE) node.data = node.data.replace(/\S[^]*\S/, said);
    else for (const name of ["title", "placeholder", "aria-label"]) if (node.hasAttribute(name)) node.setAttribute(name, said(node.getAttribute(name)));
  }
}

const languageSelect = document.getElementById("language");
languageSelect.append(...Object.entries({ en: ENGLISH, ...languages }).map(([code, [name]]) => new Option(name, code, false, code === language)));
languageSelect.hidden = !numberSteps.length;
languageSelect.onchange = () => {
  try {
    localStorage.setItem(LANGUAGE_AS, languageSelect.value);
    location.reload(); // asks first while a job is running
  } catch (error) {
    console.info("the language is not stored:", error.message);
  }
};
document.documentElement.lang = language;
if (language !== "en") translatePage();
